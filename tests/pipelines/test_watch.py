"""A run that is to end and whose optimiser does not answer."""

import time

import pytest

import pipelines.progress
from lmd.optimisers.ledger import Budget
from lmd.optimisers.random_search import RandomSearch
from pipelines.operations.signals import Stop
from pipelines.progress import Watch

SOON = 0.3  # seconds


@pytest.fixture
def stop(monkeypatch):
    """A `Stop` of the run's own; what is said of it is in the list `told`."""
    made = Stop()
    monkeypatch.setattr(pipelines.progress, "stop", made)
    monkeypatch.setattr(pipelines.progress, "PATIENCE", SOON)
    monkeypatch.setattr(pipelines.progress, "LOOK_SECONDS", 0.02)
    return made


@pytest.fixture
def told(monkeypatch):
    said = []
    monkeypatch.setattr(pipelines.progress, "tell", said.append)
    return said


def waited(watch, until=10.0):
    deadline = time.monotonic() + until
    while not watch.is_overdue and time.monotonic() < deadline:
        time.sleep(0.02)
    return watch.is_overdue


def test_told_to_stop_it_says_whom_it_waits_for_and_the_next_signal_ends_it(stop, told):
    optimiser = RandomSearch()
    with Watch(optimiser, Budget(evaluations=10)) as watch:
        assert not waited(watch, 2 * SOON)  # nothing is to end
        stop._number = 2
        assert waited(watch)
        time.sleep(2 * SOON)
        optimiser.ledger.note(1, 0.5)  # it has answered
        time.sleep(0.2)
        assert not watch.is_overdue
    assert told == [
        "told to stop, RandomSearch has been waited for 0.3 s; once more to stop at once with the best so far"
    ]


@pytest.mark.usefixtures("stop")
def test_after_its_seconds_it_says_whom_it_waits_for(told):
    with Watch(RandomSearch(), Budget(seconds=0.1)) as watch:
        assert waited(watch)
    waited_for = "RandomSearch has been waited for 0.3 s"
    assert told == [f"budget.seconds = 0.1 is over, {waited_for}; Ctrl-C to stop at once with the best so far"]


def test_an_optimiser_that_answers_is_not_waited_for(stop, told):
    optimiser = RandomSearch()
    stop._number = 2
    with Watch(optimiser, Budget(evaluations=10)) as watch:
        for number in range(1, 30):
            optimiser.ledger.note(number, 0.5)
            time.sleep(0.05)
        assert not watch.is_overdue
    assert not told
