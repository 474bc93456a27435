"""Jobs shared between worker processes."""

import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from typing import TypeVar

from lmd.core.checks import InputError, integer
from lmd.core.threads import available_threads

Job = TypeVar("Job")
Result = TypeVar("Result")
OWN_PACKAGES = ("lmd.", "pipelines.")


def in_processes(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    workers: int | None,
    name: Callable[[Job], str],
    ordered: bool = False,
) -> Generator[Result, None, None]:
    """Yield the result of a function for each job, computed in worker processes, or in this process if one process is
    enough.

    When a worker is killed, all jobs that it may have been running are repeated, one at a time.

    Args:
        function: function whose argument is a job; a worker imports the function by its name.
        jobs: the jobs.
        workers: number of processes; None for every processor.
        name: function that returns the name of a job, for messages.
        ordered: True to yield results in the order of the jobs, False to yield them as jobs finish.

    Raises:
        InputError: `workers` is not positive; the worker of a repeated job was killed; or the system has no semaphores.
    """
    count = min(processes(workers), len(jobs))
    if count <= 1:
        return (function(job) for job in jobs)
    results = _results(function, jobs, count, name)
    return _in_order(results) if ordered else (result for _, result in results)


def processes(workers: int | None) -> int:
    """Number of processes for a setting `workers`; None means the number of processors.

    Raises:
        InputError: `workers` is not positive.
    """
    return available_threads() if workers is None else integer("workers", workers, low=1)


def _results(
    function: Callable[[Job], Result], jobs: Sequence[Job], workers: int, name: Callable[[Job], str]
) -> Iterator[tuple[int, Result]]:
    """Yield the index and the result of each job, in the order in which the jobs finish."""
    waiting = deque(range(len(jobs)))
    while waiting:
        in_hand: dict[Future[Result], int] = {}
        with _pool(workers) as pool, suppress(BrokenProcessPool):
            while waiting or in_hand:
                while waiting and len(in_hand) < 2 * workers:  # so that no worker waits for its next job
                    future = pool.submit(function, jobs[waiting[0]])
                    in_hand[future] = waiting.popleft()
                for future in wait(in_hand, return_when=FIRST_COMPLETED).done:
                    result = future.result()
                    yield in_hand.pop(future), result
        for number in in_hand.values():
            yield number, _alone(function, jobs[number], name)


def _alone(function: Callable[[Job], Result], job: Job, name: Callable[[Job], str]) -> Result:
    with _pool(1) as pool:
        try:
            return pool.submit(function, job).result()
        except BrokenProcessPool:
            raise InputError(
                f"workers: the process that worked on {name(job)} was killed, even when it ran alone; there may be too "
                "little memory.",
                "workers",
            ) from None


def _in_order(results: Iterable[tuple[int, Result]]) -> Generator[Result, None, None]:
    early: dict[int, Result] = {}
    following = 0
    for number, result in results:
        early[number] = result
        while following in early:
            yield early.pop(following)
            following += 1


@contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Context with a pool of worker processes; the processes end at the end of the context."""
    ready_server()
    others = multiprocessing.active_children()
    try:
        pool = ProcessPoolExecutor(workers, multiprocessing.get_context("forkserver"), _begin)
    except OSError as error:  # if /dev/shm is missing or full
        raise InputError(
            f"workers need semaphores of the operating system ({error}); set workers=1.", "workers"
        ) from None
    try:
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in multiprocessing.active_children():
            if process not in others:
                process.terminate()


def ready_server() -> None:
    """Prepare a server process from which workers are forked, so that workers start quickly.

    The server imports those of the project's modules that this process has loaded.
    """
    multiprocessing.set_forkserver_preload([name for name in sys.modules if name.startswith(OWN_PACKAGES)])


def _begin() -> None:
    """Prepare a worker: it ignores a terminal's interrupts, and ends when its parent process ends.

    The parent receives the interrupts, too, and ends its workers.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_the_parent, daemon=True).start()


def _end_with_the_parent() -> None:
    """End this worker when its parent process ends."""
    parent = multiprocessing.parent_process()
    assert parent is not None, "a worker has one"
    parent.join()
    os._exit(1)
