"""Threads that share the work of one process: kernels release the GIL."""

import itertools
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import cache
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")

MOST_THREADS = 1024  # greatest number of threads that a user may ask for


def available_threads() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def _helpers(count: int) -> ThreadPoolExecutor:
    """Threads that stay alive: starting new ones takes a millisecond, half an evaluation of the paper's room.

    Every call of `at_once` in a process uses them.
    """
    return ThreadPoolExecutor(count)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_helpers.cache_clear)  # the threads are the parent's


def at_once(threads: int, work: Callable[..., T], *arguments: Iterable[Any]) -> list[T]:
    """Results of `work` for each of the arguments, in their order, as `map` would return them.

    The calling thread works too, so it can be interrupted as if it were alone. After an error no thread begins another
    call, and calls that have begun are waited for. `work` may itself call `at_once`: calls for which no thread is free
    run in the calling one.
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
        except BaseException:  # told to stop while waiting: arrays that others still write must not be left to them
            wait(begun)
            raise
    for other in begun:
        other.result()
    return found


def _exhaust(left: Iterator[int]) -> None:
    for _ in left:
        pass


def in_parts(threads: int, work: Callable[[int, int], object], size: int, parts: int) -> None:
    """Do `work(first, last)` for `parts` equal parts of `range(size)`, or each of its numbers if those are fewer."""
    edges = np.linspace(0, size, min(size, parts) + 1).astype(int).tolist()
    at_once(threads, lambda part: work(*part), itertools.pairwise(edges))
