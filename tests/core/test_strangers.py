"""numba is to others what it was before they imported `lmd`."""

import subprocess
import sys

import pytest
from support.processes import ROOT, environment


def ran(*arguments, cwd):
    line = [sys.executable, *arguments]
    environ = environment(ROOT / "tests", ROOT / "tests" / "core")
    return subprocess.run(line, cwd=cwd, env=environ, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_numba_and_llvmlite_are_left_as_they_were(tmp_path):
    """7 s of processor time."""
    done = ran("-m", "others_numba", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "changed: []"


# Of numba's own tests; the first take 10 s of processor time, those of the second line 70 s.
QUICK = ("test_compiler_lock", "test_tuples.TestTupleReturn", "test_tuples.TestNamedTuple", "test_event")
LONG = ("test_tuples", "test_dispatcher", "test_jitclasses")


@pytest.mark.slow
@pytest.mark.thorough("constraints.txt", "lmd/core")
@pytest.mark.parametrize("names", [QUICK, LONG], ids=["quick", "long"])
def test_numbas_own_tests_pass_in_a_process_that_has_used_this(names, tmp_path):
    modules = [f"numba.tests.{name}" for name in names]
    code = f"import unittest, used; unittest.main(None, argv={['', *modules]})"
    done = ran("-c", code, cwd=tmp_path)
    assert done.returncode == 0, done.stderr[-3000:]
    assert "\nOK" in done.stderr
