"""Work shared between processes."""

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")


def in_processes(
    function: Callable[[Job], Result], jobs: Sequence[Job], workers: int | None, ordered: bool = False
) -> Iterator[Result]:
    """Results from processes of their own when there is more than one worker.

    Args:
        function: does a job; a process of its own must find it by its name.
        jobs: what is done.
        workers: processes; None for every processor.
        ordered: results in the order of the jobs, not as they come.

    Raises:
        InputError: `workers` is not positive.
    """
    from lmd.checks import integer
    from lmd.threads import available_threads

    count = available_threads() if workers is None else integer("workers", workers, low=1)
    return _results(function, jobs, min(count, len(jobs)), ordered)


def _results(function: Callable[[Job], Result], jobs: Sequence[Job], workers: int, ordered: bool) -> Iterator[Result]:
    if workers <= 1:
        yield from map(function, jobs)
        return
    with multiprocessing.get_context("spawn").Pool(workers, initializer=_leave_interrupts) as pool:
        yield from (pool.imap if ordered else pool.imap_unordered)(function, jobs)


def _leave_interrupts() -> None:
    """A terminal interrupts the workers, too, each of which would print a traceback; who began them ends them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
