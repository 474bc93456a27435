"""Processor time of each file of tests: `PYTHONPATH=benchmarks python -m pytest -p processor_time`, with `-n` or not.

A plugin of pytest. It prints seconds of the test process, of them those that numba compiled, and of the processes it
waited for and forked from a warm one.
"""

import os
import resource
import time
from collections import defaultdict
from collections.abc import Iterator
from multiprocessing import forkserver
from pathlib import Path
from typing import Any

import pytest
from numba.core.event import Event, Listener, register

KINDS = "own", "compiling", "waited", "forked"
spent: defaultdict[tuple[str, str], float] = defaultdict(float)  # by file and kind


class _Compiling(Listener):
    """Adds up what compiling takes, parts of a kernel with it."""

    def __init__(self) -> None:
        self.depth, self.began, self.seconds = 0, 0.0, 0.0

    def on_start(self, event: Event) -> None:
        if not self.depth:
            self.began = time.process_time()
        self.depth += 1

    def on_end(self, event: Event) -> None:
        self.depth -= 1
        if not self.depth:
            self.seconds += time.process_time() - self.began


compiling = _Compiling()
register("numba:compile", compiling)  # type: ignore[no-untyped-call]


def _forked() -> float:
    """Of the fork server and all that it has waited for, seconds."""
    pid = forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined]
    if pid is None:
        return 0.0
    ticks = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[11:15]
    return sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")


def _now() -> tuple[float, ...]:
    waited = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time(), compiling.seconds, waited.ru_utime + waited.ru_stime, _forked()


@pytest.hookimpl(trylast=True)
def pytest_configure() -> None:
    """Let each worker fork from a server of its own, whose time is that of its tests."""
    server = forkserver._forkserver  # type: ignore[attr-defined]
    vars(server).clear()
    server.__init__()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[Any]:
    """Note what a test has spent, with its fixtures."""
    before = _now()
    done = yield
    for kind, a, b in zip(KINDS, before, _now(), strict=True):
        spent[item.nodeid.partition("::")[0], kind] += b - a
    return done


def pytest_sessionfinish(session: pytest.Session) -> None:
    """A worker hands in what it has noted."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["spent"] = [[*key, seconds] for key, seconds in spent.items()]


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Take what a worker has handed in."""
    for file, kind, seconds in getattr(node, "workeroutput", {}).get("spent", []):
        spent[file, kind] += seconds


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Print the files that took most, and the sum."""
    files = sorted({file for file, _ in spent}, key=lambda f: -sum(spent[f, k] for k in KINDS if k != "compiling"))
    rows = [(file, [spent[file, kind] for kind in KINDS]) for file in files]
    rows.append(("all", [sum(spent[file, kind] for file in files) for kind in KINDS]))
    for file, seconds in rows:
        told = "  ".join(f"{kind} {value:7.1f}" for kind, value in zip(KINDS, seconds, strict=True))
        terminalreporter.write_line(f"{told}  {file}")
