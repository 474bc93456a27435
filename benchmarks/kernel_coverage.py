"""List the lines of compiled code that tests reach: `NUMBA_DISABLE_JIT=1 python benchmarks/kernel_coverage.py [TESTS]`.

Runs tests in this process, with kernels as plain Python, and notes the lines of compiled functions that are run. Prints
Markdown: a table by module, the lines that no test reached, and the tests that were given up since they took too long.
Tests that start processes reach nothing here.
"""

import ast
import importlib
import os
import pkgutil
import signal
import sys
import threading
import time
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).resolve().parents[1]
COMPILED = ("kernel", "borrowing", "inner", "inlined", "allocating", "register", "overridable")
TESTS = (
    *("tests/sight", "tests/objectives", "tests/space", "tests/geometry", "tests/scene/test_footprints.py"),
    *("tests/optimisers/test_walk.py", "tests/optimisers/test_ascent.py", "tests/planner/test_additions.py"),
    *("tests/test_disabled_compiler.py", "tests/test_plain_criteria.py"),
)
EXAMPLES = "0.03"  # of what property tests draw in `make test-thorough`
LIMIT, FILE_LIMIT = 10.0, 40.0  # processor time of a test, and of those of a file, seconds


class Observed:
    """A plugin of pytest that observes tests with a tracer, and skips those that take longer than the limits.

    Args:
        tracer: for `sys.settrace`.
    """

    def __init__(self, tracer: Any) -> None:
        self._tracer, self.given_up = tracer, list[str]()
        self._left: dict[Path, float] = {}
        signal.signal(signal.SIGPROF, self._give_up)

    def _give_up(self, *_: object) -> None:
        pytest.skip("too slow without the compiler")

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        """Prepare a test."""
        return (yield from self._limited(item))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        """Run a test."""
        return (yield from self._limited(item))

    def _limited(self, item: pytest.Item) -> Iterator[None]:
        left, start = self._left.setdefault(item.path, FILE_LIMIT), time.process_time()
        signal.setitimer(signal.ITIMER_PROF, min(max(left, 0.01), LIMIT))
        threading.settrace(self._tracer)
        sys.settrace(self._tracer)
        try:
            return (yield)
        except pytest.skip.Exception as reason:
            if str(reason).startswith("too slow"):
                self.given_up.append(item.nodeid)
            raise
        finally:
            sys.settrace(None)
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            self._left[item.path] -= time.process_time() - start


class Lines:
    """The lines of compiled functions, and those that have run."""

    def __init__(self) -> None:
        self.all: dict[str, dict[str, set[int]]] = {}
        self._left: dict[str, dict[int, set[int]]] = {}

    def add(self, module: types.ModuleType) -> None:
        """Note the compiled functions of a module."""
        assert module.__file__, "modules of lmd have files"
        source = Path(module.__file__).read_text(encoding="utf-8")
        code = compile(source, module.__file__, "exec")
        functions = {part.co_name: part for part in code.co_consts if isinstance(part, types.CodeType)}
        for node in compiled(ast.parse(source)):
            function, first = functions[node.name], node.body[0].lineno
            lines = {line for _, _, line in function.co_lines() if line and line >= first}
            self.all.setdefault(module.__file__, {})[node.name] = lines
            self._left.setdefault(module.__file__, {})[function.co_firstlineno] = set(lines)

    def left(self, file: str) -> set[int]:
        """The lines of a file that have not run."""
        return set().union(*self._left[file].values())

    def enter(self, frame: types.FrameType, *_: object) -> Any:
        """A function is called: for `sys.settrace`."""
        code = frame.f_code
        lines = self._left.get(code.co_filename, {}).get(code.co_firstlineno)
        if not lines:
            return None

        def trace(frame: types.FrameType, *_: object) -> Any:
            lines.discard(frame.f_lineno)
            return trace

        return trace


def compiled(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    """The functions of a module that are compiled: by a decorator, or by a call with their name."""
    called = {
        argument.id
        for call in ast.walk(tree)
        if isinstance(call, ast.Call) and _is_decorator(call.func)
        for argument in call.args
        if isinstance(argument, ast.Name)
    }
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and (node.name in called or any(map(_is_decorator, node.decorator_list))):
            yield node


def _is_decorator(part: ast.expr) -> bool:
    """Return whether a decorator is, or calls, one of `COMPILED`."""
    names = {each.id for each in ast.walk(part) if isinstance(each, ast.Name)}
    return bool((names | {each.attr for each in ast.walk(part) if isinstance(each, ast.Attribute)}) & set(COMPILED))


def spans(lines: set[int]) -> str:
    """Numbers of lines as text, neighbours together."""
    parts: list[list[int]] = []
    for line in sorted(lines):
        if parts and line == parts[-1][-1] + 1:
            parts[-1].append(line)
        else:
            parts.append([line])
    return ", ".join(f"{part[0]}-{part[-1]}" if len(part) > 1 else str(part[0]) for part in parts)


def main() -> None:
    """Run the tests and print what they reach."""
    if not os.environ.get("NUMBA_DISABLE_JIT"):
        sys.exit("error: set NUMBA_DISABLE_JIT=1, so that kernels are plain Python.")
    os.environ.setdefault("LMD_EXAMPLES", EXAMPLES)
    sys.path[:0] = [str(HERE), str(HERE / "tests")]
    os.chdir(HERE)
    import lmd

    lines, start = Lines(), time.process_time()
    for found in pkgutil.walk_packages(lmd.__path__, "lmd."):
        if not found.name.startswith(("lmd.pipelines", "lmd.conf")):
            lines.add(importlib.import_module(found.name))
    observed = Observed(lines.enter)
    status = pytest.main(["-v", "-p", "no:cacheprovider", *(sys.argv[1:] or TESTS)], plugins=[observed])
    print(f"\npytest ended with {int(status)}, after {time.process_time() - start:.0f} s of processor time.\n")
    print("| module | lines | reached |\n| --- | --- | --- |")
    missed: list[str] = []
    whole = hit = 0
    for file, functions in sorted(lines.all.items()):
        name, left = str(Path(file).relative_to(HERE)), lines.left(file)
        size = len(set().union(*functions.values()))
        whole, hit = whole + size, hit + size - len(left)
        print(f"| `{name}` | {size} | {1.0 - len(left) / size:.0%} |")
        for function, own in functions.items():
            if own & left:
                missed.append(f"- `{name}`, `{function}`: {spans(own & left)}; {len(own & left)} of {len(own)}")
    print(f"| all | {whole} | {hit / whole:.1%} |\n\nNot reached:\n\n" + "\n".join(missed))
    print("\nGiven up:\n\n" + "\n".join(f"- `{name}`" for name in observed.given_up))


if __name__ == "__main__":
    main()
