"""Work shared between processes."""

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")


def in_processes(function: Callable[[Job], Result], jobs: Sequence[Job], workers: int | None) -> Iterator[Result]:
    """Results as they come, in any order, from processes of their own when there is more than one worker.

    Args:
        function: does a job; a process of its own must find it by its name.
        jobs: what is done.
        workers: processes; None for every processor.

    Raises:
        InputError: `workers` is not positive.
    """
    from lmd.checks import integer
    from lmd.sight.evaluator import available_threads

    count = available_threads() if workers is None else integer("workers", workers, low=1)
    return _results(function, jobs, min(count, len(jobs)))


def _results(function: Callable[[Job], Result], jobs: Sequence[Job], workers: int) -> Iterator[Result]:
    if workers <= 1:
        yield from map(function, jobs)
        return
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        yield from pool.imap_unordered(function, jobs)
