"""numba as it comes, for versions whose inside is not known: the same results, which only take longer to compile."""

import json
import os
import subprocess
import sys

import pytest
from support.processes import ROOT, environment
from support.small import problem

import lmd
from lmd.core import compiled
from lmd.core.compiled import PLAIN
from lmd.optimisers.genetic import RandomSearch

OPTIMISERS = {"walk": None, "evaluate": RandomSearch}
# Interpreters of environments with other versions of numba, such as the oldest that is allowed: `NUMBAS=old/bin/python`
OTHERS = os.environ.get("NUMBAS", "").split()


def found_by(method):
    optimiser = OPTIMISERS[method] and OPTIMISERS[method]()
    found = lmd.optimise(problem(), evaluations=60, optimiser=optimiser)
    return [compiled.LINKED, found.fitness, found.deployment.positions.tolist()]


def run(python, method, cwd, **variables):
    """What another interpreter finds, and what it says."""
    code = f"import json, test_plain_numba; print(json.dumps(test_plain_numba.found_by({method!r})))"
    environ = environment(ROOT / "tests") | variables
    done = subprocess.run([python, "-c", code], cwd=cwd, env=environ, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    "method",
    [
        pytest.param("evaluate", marks=pytest.mark.thorough("lmd/core", "lmd/sight")),
        # The walk takes 30 s to compile so.
        pytest.param("walk", marks=pytest.mark.thorough("lmd/core")),
    ],
)
def test_with_numba_as_it_comes_the_results_are_the_same_and_kernels_are_kept(method, tmp_path):
    """10 s of processor time."""
    linked, *known = found_by(method)
    assert linked
    for compiles in (True, False):
        (linked, *found), said = run(sys.executable, method, tmp_path, **{PLAIN: "1", "NUMBA_CACHE_DIR": str(tmp_path)})
        assert not linked
        assert found == known
        assert ("compiling kernel 1" in said) == compiles


@pytest.mark.skipif(not OTHERS, reason="NUMBAS names no other environment")
@pytest.mark.parametrize("python", OTHERS)
def test_with_other_versions_of_numba_the_results_are_the_same_and_kernels_are_kept(python, tmp_path):
    """40 s of processor time for each."""
    for method in OPTIMISERS:
        _, *known = found_by(method)
        (linked, *found), _ = run(python, method, tmp_path, NUMBA_CACHE_DIR=str(tmp_path))
        assert linked
        assert found == known
        assert "compiling" not in run(python, method, tmp_path, NUMBA_CACHE_DIR=str(tmp_path))[1]
