"""Work beside whoever changes the plan."""

import threading

from lmd.deployment import Deployment
from lmd.planner.worker import Worker

LIMIT = 60.0


def tags():
    return Deployment([[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])


def test_the_latest_counts_and_what_was_given_up_is_begun_again():
    begun, told, finished = threading.Semaphore(0), threading.Event(), []

    def work(deployment, wanted):
        begun.release()
        if not told.is_set():
            while wanted():
                pass
        finished.append((deployment, wanted()))

    worker, (one, two) = Worker(work), (tags(), tags())
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
    worker, one = Worker(lambda *_: done.release()), tags()
    for _ in range(3):
        worker.ask(one)
        assert done.acquire(timeout=LIMIT)
        worker.ask(None)
    worker.close()
    assert not done.acquire(blocking=False)
