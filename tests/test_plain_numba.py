"""A version of numba whose inside is not known: everything works, and only takes longer."""

import json
import subprocess
import sys

import pytest
from examples import SHARE
from processes import ROOT, environment

from lmd.core.compiled import PLAIN

CODE = """
import json, sys
from small import problem
import lmd
from lmd.core import compiled
from lmd.optimisers.random_search import RandomSearch
optimiser = {} if sys.argv[1] == "walk" else {"optimiser": RandomSearch()}
found = lmd.optimise(problem(), evaluations=60, **optimiser)
print(json.dumps([compiled._inside is None, found.fitness, found.deployment.positions.tolist()]))
"""


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
    found = []
    for variables in ({}, {PLAIN: "1"}):
        environ = environment(ROOT / "tests") | variables
        line = [sys.executable, "-c", CODE, method]
        done = subprocess.run(line, cwd=tmp_path, env=environ, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        found.append(json.loads(done.stdout))
    (known, *kept), (plain, *anew) = found
    assert (known, plain) == (False, True)
    assert kept == anew
