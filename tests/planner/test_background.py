"""Background work: the worker's thread, and figures off the grid."""

import threading
from itertools import count

import numpy as np
import pytest
from support.small import problem

from lmd.core.checks import InputError
from lmd.evaluation.validation import Sample, describe_validation, validation_metrics
from lmd.planner.background import ESTIMATE, FIRST_SAMPLE, Worker, off_grid
from lmd.scene.deployment import Deployment

LIMIT = 60.0
SMALL = Sample(groups=4, positions=32, divisions=4)


def tags():
    return Deployment([[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])


def fail(_, why):
    raise AssertionError(why)


def test_only_the_latest_question_counts_and_an_abandoned_one_can_be_asked_again():
    begun, released, finished = threading.Semaphore(0), threading.Event(), []

    def work(deployment, wanted):
        begun.release()
        if not released.is_set():
            while wanted():
                pass
        finished.append((deployment, wanted()))

    worker, (one, two) = Worker(work, fail), (tags(), tags())
    worker.ask(one)
    assert begun.acquire(timeout=LIMIT)
    worker.ask(two)
    assert begun.acquire(timeout=LIMIT)
    worker.ask(None)
    released.set()
    worker.ask(one)
    assert begun.acquire(timeout=LIMIT)
    worker.ask(one)  # is already answered
    worker.close()
    assert all(done is asked for (done, _), asked in zip(finished, (one, two, one), strict=True))
    assert [wanted for _, wanted in finished[:2]] == [False, False]
    assert not begun.acquire(blocking=False)


@pytest.mark.parametrize(
    ("error", "text"),
    [(InputError("it is too big."), "it is too big."), (MemoryError(), "there is too little memory.")],
)
def test_a_failure_is_reported_and_the_next_question_is_answered(error, text):
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
    assert [(deployment is one, why) for deployment, why in failed] == [(True, text)]


def test_an_estimate_precedes_the_figures_of_evaluate(monkeypatch):
    monkeypatch.setattr("lmd.planner.background.Sample", lambda: SMALL)
    planned = problem()
    tags = planned.draw(np.random.default_rng(0))
    first, whole = off_grid(planned, tags, 5, lambda: True)
    for rows, sample, more in ((first, FIRST_SAMPLE, ESTIMATE), (whole, SMALL, {})):
        assert rows == describe_validation(planned, validation_metrics(planned, tags, 5, sample)) | more


def test_unwanted_figures_end_before_the_next_group_of_positions(monkeypatch):
    planned = problem()
    tags, evaluated, values = planned.draw(np.random.default_rng(0)), [], type(planned.objective).values
    monkeypatch.setattr(
        type(planned.objective), "values", lambda *args: (evaluated.append(len(args[1].positions)), values(*args))[1]
    )
    for last in (1, 3, FIRST_SAMPLE.groups + 1, FIRST_SAMPLE.groups + 3):
        evaluated.clear()
        asked = count()
        rows = list(off_grid(planned, tags, 0, lambda asked=asked, last=last: next(asked) < last))
        assert len(rows) == (last > FIRST_SAMPLE.groups)
        assert len(evaluated) <= last + 2  # the finer grids of both samples are evaluated without a check
