"""A version of numba whose inside is not known: everything works, and only takes longer."""

import json
import subprocess
import sys

import pytest
from examples import SHARE
from processes import ROOT, environment
from small import problem

import lmd
from lmd.core import compiled
from lmd.core.compiled import PLAIN
from lmd.optimisers.random_search import RandomSearch

OPTIMISERS = {"walk": None, "evaluate": RandomSearch}


def found_by(method):
    optimiser = OPTIMISERS[method] and OPTIMISERS[method]()
    found = lmd.optimise(problem(), evaluations=60, optimiser=optimiser)
    return [compiled._inside is None, found.fitness, found.deployment.positions.tolist()]


@pytest.mark.slow
@pytest.mark.parametrize(
    "method",
    [
        "evaluate",
        # The walk takes 50 s to compile so.
        pytest.param("walk", marks=pytest.mark.skipif(SHARE < 1.0, reason="in make test-thorough")),
    ],
)
def test_without_numbas_inside_the_results_are_the_same(method, tmp_path):
    code = f"import json, test_plain_numba; print(json.dumps(test_plain_numba.found_by({method!r})))"
    line, environ = [sys.executable, "-c", code], environment(ROOT / "tests") | {PLAIN: "1"}
    done = subprocess.run(line, cwd=tmp_path, env=environ, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (known, *kept), (plain, *anew) = found_by(method), json.loads(done.stdout)
    assert (known, plain) == (False, True)
    assert kept == anew
