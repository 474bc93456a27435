import ast
import gc
import math
import pickle
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from processes import call

import lmd
from lmd.core import compiled, inside_numba
from lmd.core.compiled import inlined, inner, kernel

PACKAGE = Path(lmd.__file__).parent
DECORATORS = (
    *("kernel", "inner", "inlined", "allocating", "intrinsic", "register"),
    *("dispatched", "dispatched_call", "overridable"),
)


def is_compiled(function):
    """Whether a decorator makes it a part of a kernel."""
    texts = [ast.unparse(decorator).partition("(")[0] for decorator in function.decorator_list]
    return any(text.split(".")[-1] in DECORATORS for text in texts)


def names_in(nodes):
    return {node.id for part in nodes for node in ast.walk(part) if isinstance(node, ast.Name)}


def made_of(tree):
    """The modules of `lmd` from which what is compiled in a file takes functions and constants."""
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef) and is_compiled(node)]
    used = names_in(part for function in functions for part in function.body)
    constants = [node for node in tree.body if isinstance(node, ast.Assign | ast.AnnAssign)]
    while more := names_in(c.value for c in constants if c.value and names_in([c]) & used) - used:
        used |= more
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("lmd")]
    return functions, {node.module for node in imports for alias in node.names if (alias.asname or alias.name) in used}


def makes_stale(path):
    return any(path.with_suffix("").is_relative_to(PACKAGE / source) for source in compiled.SOURCES)


def test_all_that_kernels_are_made_of_makes_them_stale():
    found = {path: made_of(ast.parse(path.read_text())) for path in PACKAGE.rglob("*.py")}
    sources = {path: modules for path, (functions, modules) in found.items() if functions}
    assert len(sources) > 15
    for path, modules in sources.items():
        assert makes_stale(path), f"{path} is compiled"
        for module in modules:
            source = PACKAGE.parent / module.replace(".", "/")
            assert makes_stale(source), f"{path} compiles parts of {module}"


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


def test_inner_functions_are_parts_of_kernels_and_can_be_called_from_python():
    values = np.array([0.0, 2.0, 8.0, 32.0])
    assert _sum_of_roots(values) == 7.0
    assert [_root_of_half(x) for x in values] == [0.0, 1.0, 2.0, 4.0]
    assert _half(3.0) == 1.5
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


@pytest.fixture
def compiling(monkeypatch):
    """A listener of its own, and a clock that is set by hand."""
    now = [0.0]
    monkeypatch.setattr(compiled.time, "perf_counter", lambda: now[0])
    return compiled._Compiling(), now


def test_the_clock_stands_still_while_kernels_and_their_parts_are_compiled(compiling, capsys):
    listener, now = compiling
    readings, event = [], SimpleNamespace(data={"dispatcher": _sum_of_roots})
    for moment, happens in enumerate((listener.on_start, listener.on_start, listener.on_end, listener.on_end)):
        now[0] = 10.0 * (moment + 1)
        happens(event)
        now[0] += 1.0
        readings.append(listener.clock())
    assert readings == [10.0, 10.0, 10.0, 11.0]
    told = capsys.readouterr().err.splitlines()
    assert told == [
        "compiling what this needs; it is kept for the next time",
        "compiling kernel 1, 0 s so far: test_compiled._sum_of_roots",
    ]


@pytest.fixture
def often():
    """How often Python looks for garbage by default."""
    before = gc.get_threshold()
    gc.set_threshold(700, 10, 10)
    yield 700, 10, 10
    gc.set_threshold(*before)


def test_garbage_is_looked_for_as_often_as_before_once_kernels_are_compiled(compiling, often):
    listener, _ = compiling
    event = SimpleNamespace(data={"dispatcher": _sum_of_roots})
    for happens in (listener.on_start, listener.on_start, listener.on_end):
        happens(event)
        assert gc.get_threshold()[0] > often[0]
    listener.on_end(event)
    assert gc.get_threshold() == often


def test_where_nothing_can_be_written_kernels_are_compiled_all_the_same(monkeypatch, capsys):
    def refuse(*_):
        raise RuntimeError("no locator available")

    monkeypatch.setattr(inside_numba, "_Cache", refuse)
    monkeypatch.setattr(compiled, "_compiling", compiled._Compiling())
    double = kernel(lambda x: 2.0 * x)
    assert double(1.5) == 3.0
    event = SimpleNamespace(data={"dispatcher": double})
    compiled._compiling.on_start(event)
    compiled._compiling.on_end(event)
    assert "it cannot be kept, as no folder can be written to; NUMBA_CACHE_DIR=DIR" in capsys.readouterr().err


@pytest.mark.parametrize("damage", [b"", b"cgone.module\nClass\n.", b"cmath\ngone\n.", b"\x80"])
def test_what_was_kept_and_cannot_be_read_is_compiled_anew(tmp_path, damage):
    index = inside_numba._Index(str(tmp_path), "kernel", "stamp")
    index.save("key", "machine code")
    assert index.load("key") == "machine code"
    path = tmp_path / "kernel.nbi"
    version = pickle.dumps(index._version, protocol=-1)
    assert path.read_bytes().startswith(version)
    path.write_bytes(version + damage)
    assert index.load("key") is None
    index.save("key", "machine code")
    assert index.load("key") == "machine code"


def test_without_the_compiler_there_is_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    done = call("optimise", cwd=tmp_path, fresh=True)
    assert (done.returncode, done.stderr.splitlines()) == (
        1,
        ["error: NUMBA_DISABLE_JIT is set, but lmd's kernels are for the compiler: unset it."],
    )
