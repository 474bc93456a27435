import contextlib
import gc
import math
import pickle
import subprocess
import sys
from itertools import count

import numba
import numpy as np
import pytest
from support.processes import ROOT, environment

from lmd.core import compile_clock, compiled, inside_numba
from lmd.core.compiled import allocating, borrowing, inlined, inner, kernel


@inlined
def _half(x):
    return 0.5 * x


@inner
def _root_of_half(x):
    if x < 0.0:
        raise ValueError("negative")
    return math.sqrt(_half(x))


@kernel
def _sum_of_roots(values):
    total = 0.0
    for x in values:
        total += _root_of_half(x)
    return total


def test_inner_functions_are_parts_of_kernels_and_python_for_python():
    values = np.array([0.0, 2.0, 8.0, 32.0])
    assert _sum_of_roots(values) == 7.0
    assert [_root_of_half(x) for x in values] == [0.0, 1.0, 2.0, 4.0]
    assert _half(values).tolist() == [0.0, 1.0, 4.0, 16.0]
    for attempt in (lambda: _sum_of_roots(-values), lambda: _root_of_half(-1.0)):
        with pytest.raises(ValueError, match="negative"):
            attempt()


@inner
def _next(x):
    return x * x + 1


@inner
def _never_next(x):
    return _next(x) if x - x > 0 else x  # LLVM sees that it never is


@inner
def _second_next(x):
    return _next(_next(x))


@kernel
def _both(x):
    return _never_next(x) + _second_next(x)


def test_what_an_inner_function_calls_is_linked_where_another_that_could_does_not():
    """Else the process would die: LLVM leaves out of a kernel what nothing in it calls by then."""
    assert _both(2) == 28


@numba.njit
def _of_a_user(x):
    return _second_next(x) + _root_of_half(8.0)


def test_a_numba_function_of_a_user_calls_inner_functions():
    assert _of_a_user(2) == 28.0


@inner
def _slices(a, n):
    return a[:n], a[n:]


@inner
def _given(a):
    return a


@kernel
def _return_slices(a):
    return a[:2], a[2:]


@borrowing
def _return_what_is_borrowed(a):
    return a


@inner
def _printed(x):
    print(x)
    return x


HELD = r"returns arrays, which would be freed"
ARRAY = np.arange(5.0)


@pytest.mark.parametrize(
    ("refused", "argument", "name", "message"),
    [
        (kernel(lambda a: _slices(a, 2)), ARRAY, "_slices", HELD),
        (kernel(lambda a: _given(a)), ARRAY, "_given", HELD),
        (_return_slices, ARRAY, "_return_slices", HELD),
        (_return_what_is_borrowed, ARRAY, "_return_what_is_borrowed", HELD),
        (kernel(lambda n: len(_given([float(n), 2.0]))), 3, "_given", HELD),
        (kernel(lambda n: len(_given(str(n)))), 3, "_given", HELD),
        (kernel(lambda n: _printed(n)), 3, "_printed", "prints or uses Python objects"),
    ],
)
def test_memory_that_nothing_would_hold_is_not_returned_and_nothing_is_printed(refused, argument, name, message):
    """The memory would be freed while it is used, and the process would die."""
    with pytest.raises(TypeError, match=rf"\.{name} \(.*test_compiled.py, line \d+\) {message}"):
        refused(argument)
    assert not compile_clock.CLOCK.active


@allocating
def _doubled(a):
    return a * 2.0, a * 4.0


@kernel
def _sum_of_doubled(a):
    one, other = _doubled(a)
    return one.sum() + other.sum()


@kernel
def _copied(a):
    return a.copy()


def test_arrays_that_are_counted_are_returned():
    assert _sum_of_doubled(np.arange(4.0)) == 36.0
    assert _copied(np.arange(3.0)).tolist() == [0.0, 1.0, 2.0]


@pytest.fixture
def clock(monkeypatch):
    """A clock by itself, on a time that advances by one whenever it is read."""
    time = count(10)
    monkeypatch.setattr(compile_clock.time, "perf_counter", lambda: float(next(time)))
    return compile_clock.CompileClock()


def test_the_clock_stands_still_while_kernels_and_their_parts_are_compiled(clock, capsys):
    assert clock.read() == 10.0
    with clock.stopped(_sum_of_roots.py_func):
        assert (clock.read(), clock.active) == (11.0, True)
        with clock.stopped(_root_of_half):
            assert clock.read() == 11.0
        assert clock.read() == 11.0
    assert (clock.read(), clock.active) == (12.0, False)
    assert capsys.readouterr().err.splitlines() == [
        "compiling kernels; they are cached for the next run",
        "compiling kernel 1, 0 s so far: test_compiled._sum_of_roots",
    ]


@pytest.fixture
def often():
    """How often Python looks for garbage by default."""
    before = gc.get_threshold()
    gc.set_threshold(700, 10, 10)
    yield 700, 10, 10
    gc.set_threshold(*before)


def test_garbage_is_looked_for_as_often_as_before_once_a_kernel_is_compiled_or_is_not(clock, often):
    thresholds = []
    with contextlib.suppress(ZeroDivisionError), clock.stopped(_sum_of_roots.py_func):
        thresholds += gc.get_threshold()
        raise ZeroDivisionError
    assert thresholds[0] > often[0]
    assert gc.get_threshold() == often
    assert not clock.active


def test_where_nothing_can_be_written_kernels_are_compiled_all_the_same(monkeypatch, capsys):
    def refuse(*_):
        raise RuntimeError("no locator available")

    monkeypatch.setattr(inside_numba, "Cache", refuse)
    monkeypatch.setattr(compiled, "CLOCK", compile_clock.CompileClock())
    monkeypatch.setattr(compile_clock, "CLOCK", compiled.CLOCK)
    double = kernel(lambda x: 2.0 * x)
    assert double(1.5) == 3.0
    assert "they cannot be cached, as no cache folder is writable; set NUMBA_CACHE_DIR" in capsys.readouterr().err


@pytest.mark.parametrize("damage", [b"", b"cgone.module\nClass\n.", b"cmath\ngone\n.", b"\x80"])
@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_an_index_or_a_kernel_that_cannot_be_read_is_written_anew(tmp_path, ending, damage):
    index = inside_numba._Index(str(tmp_path), "kernel", "stamp")
    assert index.load("key") is None
    index.save("key", "machine code")
    assert index.load("key") == "machine code"
    (path,) = tmp_path.glob(f"*.{ending}")
    version = pickle.dumps(numba.__version__, protocol=-1) if ending == "nbi" else b""
    assert path.read_bytes().startswith(version)
    path.write_bytes(version + damage)
    assert index.load("key") is None
    index.save("key", "machine code")
    assert index.load("key") == "machine code"


def test_what_other_code_has_left_is_never_taken_for_a_kernel(tmp_path, monkeypatch):
    """As when a process is killed between the index and the kernel, which is written after it."""
    inside_numba._Index(str(tmp_path), "kernel", "before").save("key", "machine code of before")
    after = inside_numba._Index(str(tmp_path), "kernel", "after")
    with monkeypatch.context() as patch:
        patch.setattr(after, "_save_data", lambda *_: None)
        after.save("key", "machine code")
    assert after.load("key") is None
    after.save("key", "machine code")
    assert after.load("key") == "machine code"
    assert len(list(tmp_path.glob("*.nbc"))) == 1


def test_a_kernel_that_cannot_be_compiled_holds_up_no_other_process():
    wrong = kernel(lambda x: x.nothing)
    with pytest.raises(numba.core.errors.TypingError):
        wrong(1.0)
    assert not inside_numba.LOCKS[wrong.py_func]


MINE = """
from typing import NamedTuple

from factors import FACTOR
from lmd.incremental.field import contribution


class Mine(NamedTuple):
    weight: float


@contribution.register(Mine)
def _worth(target, p, units):
    return target.weight * units * FACTOR
"""
CALL = """
import sys; import numpy as np
from mine import Mine
from lmd.incremental.field import total_fitness

print(total_fitness(Mine(2.0), np.arange(4)))
assert "tqdm" not in sys.modules  # its lock is a semaphore, which a worker would leave behind
"""


def test_kernels_for_a_class_of_a_user_are_kept_until_its_code_changes(tmp_path, monkeypatch):
    """5 s of processor time: four processes, of which two compile."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    (tmp_path / "mine.py").write_text(MINE)
    for factor, compiles in ((1, True), (1, False), (10, True), (10, False)):
        (tmp_path / "factors.py").write_text(f"FACTOR = {factor}\n")
        line = [sys.executable, "-B", "-c", CALL]
        done = subprocess.run(line, cwd=tmp_path, env=environment(tmp_path), capture_output=True, text=True, check=True)
        assert float(done.stdout) == 12.0 * factor
        assert ("compiling kernel 1" in done.stderr) == compiles


def test_code_is_compiled_as_plain_python_where_the_compiler_is_disabled(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    code = "import test_compiled as t; import numpy as np; print(t._sum_of_roots(np.arange(4.0)), t._both(2))"
    environ = environment(ROOT / "tests", ROOT / "tests" / "core")
    line = [sys.executable, "-c", code]
    done = subprocess.run(line, cwd=tmp_path, env=environ, capture_output=True, text=True, check=True)
    assert done.stdout.split()[1] == "28"
