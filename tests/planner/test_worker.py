"""Work beside whoever changes the plan."""

import subprocess
import sys
import threading

import pytest

from lmd.core.checks import InputError
from lmd.planner.worker import Worker
from lmd.scene.deployment import Deployment

LIMIT = 60.0


def tags():
    return Deployment([[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])


def fail(_, why):
    raise AssertionError(why)


def test_the_latest_counts_and_what_was_given_up_is_begun_again():
    begun, told, finished = threading.Semaphore(0), threading.Event(), []

    def work(deployment, wanted):
        begun.release()
        if not told.is_set():
            while wanted():
                pass
        finished.append((deployment, wanted()))

    worker, (one, two) = Worker(work, fail), (tags(), tags())
    worker.ask(one)
    assert begun.acquire(timeout=LIMIT)
    worker.ask(two)
    assert begun.acquire(timeout=LIMIT)
    worker.ask(None)
    told.set()
    worker.ask(one)
    assert begun.acquire(timeout=LIMIT)
    worker.ask(one)  # once is enough
    worker.close()
    assert all(done is asked for (done, _), asked in zip(finished, (one, two, one), strict=True))
    assert [wanted for _, wanted in finished[:2]] == [False, False]
    assert not begun.acquire(blocking=False)


def test_what_was_done_is_done_again_once_it_was_none():
    done = threading.Semaphore(0)
    worker, one = Worker(lambda *_: done.release(), fail), tags()
    for _ in range(3):
        worker.ask(one)
        assert done.acquire(timeout=LIMIT)
        worker.ask(None)
    worker.close()
    assert not done.acquire(blocking=False)


@pytest.mark.parametrize(
    ("error", "said"),
    [(InputError("it is too big."), "it is too big."), (MemoryError(), "there is too little memory.")],
)
def test_what_fails_is_said_and_the_next_is_worked_on(error, said):
    one, two, done, failed = tags(), tags(), threading.Semaphore(0), []

    def work(deployment, _):
        if deployment is one:
            raise error
        done.release()

    def note(*failure):
        failed.append(failure)
        done.release()

    worker = Worker(work, note)
    for asked in (one, two):
        worker.ask(asked)
        assert done.acquire(timeout=LIMIT)
    worker.close()
    assert [(deployment is one, why) for deployment, why in failed] == [(True, said)]


@pytest.mark.slow
def test_a_process_that_ends_without_closing_it_ends():
    lines = "from lmd.planner.worker import Worker\nWorker(print, print)\nraise SystemExit(3)"
    assert subprocess.run([sys.executable, "-c", lines], timeout=LIMIT).returncode == 3
