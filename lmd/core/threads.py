"""Threads within a process; kernels release the GIL."""

import itertools
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import cache
from threading import Thread
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")

MOST_THREADS = 1024  # greatest number of threads that a setting may request


def available_threads() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def _helpers(count: int) -> ThreadPoolExecutor:
    """Pool of `count` threads, which all calls of `at_once` share, because to start threads takes a millisecond."""
    return ThreadPoolExecutor(count)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_helpers.cache_clear)  # a child process does not inherit its parent's threads


def at_once(threads: int, work: Callable[..., T], *arguments: Iterable[Any]) -> list[T]:
    """Call `work` for each set of arguments, like `map`, in at most `threads` threads; return the list of results.

    The results are in the order of the arguments. The calling thread works too, so Ctrl-C interrupts it as usual. After
    an error, no further call begins, and the function waits for calls that have begun. `work` may itself call
    `at_once`; calls for which no other thread is free run in the calling thread.
    """
    calls = list(zip(*arguments, strict=True))
    found: list[Any] = [None] * len(calls)
    left, others = iter(range(len(calls))), list[Future[None]]()

    def go() -> None:
        try:
            for i in left:
                found[i] = work(*calls[i])
        finally:
            _exhaust(left)

    try:
        for _ in range(min(threads, len(calls)) - 1):
            others.append(_helpers(threads - 1).submit(go))
        go()
    finally:
        _exhaust(left)
        begun = [other for other in others if not other.cancel()]
        try:
            wait(begun)
        except BaseException:  # after an interrupt: wait, as other threads still write to shared arrays
            wait(begun)
            raise
    for other in begun:
        other.result()
    return found


def _exhaust(left: Iterator[int]) -> None:
    for _ in left:
        pass


def in_parts(threads: int, work: Callable[[int, int], object], size: int, parts: int) -> None:
    """Call `work(first, last)`, in at most `threads` threads, for at most `parts` ranges that cover `range(size)`.

    A range is from `first` to `last - 1`; all ranges have about equal lengths.
    """
    edges = np.linspace(0, size, min(size, parts) + 1).astype(int).tolist()
    at_once(threads, lambda part: work(*part), itertools.pairwise(edges))


def in_daemon(work: Callable[..., T], *arguments: Any) -> "Future[T]":
    """Begin `work(*arguments)` in a daemon thread; return the future of the result.

    Threads that `work` starts are daemons by default, too. A process does not wait for daemons when it ends.
    """
    outcome: Future[T] = Future()

    def fulfil() -> None:
        try:
            outcome.set_result(work(*arguments))
        except BaseException as error:
            outcome.set_exception(error)

    Thread(target=fulfil, daemon=True).start()
    return outcome
