"""The curve of best fitness: all runs of a budget log at the same steps, so that the mean of a group never falls."""

from itertools import pairwise
from math import inf

import numpy as np
import pytest
from mlflow import MlflowClient

from lmd.optimisers.ledger import Budget, Record, curve
from pipelines.operations.tracking import PARENT_TAG, MlflowTracker, RunStart

# Histories with 400 evaluations: of single moves, of batches of 30, and of a method that fails at first and ends early.
HISTORIES = (
    [Record(1.0, 0.1, 0.1), Record(1.5, 0.4, 0.2), Record(399.75, 0.9, 4.0), Record(400.0, 0.9, 4.1)],
    [Record(30.0 * batch, 0.05 * batch, 0.5 * batch) for batch in range(1, 14)],
    [Record(8.0, -inf, 0.1), Record(12.0, 0.7, 0.3), Record(50.0, 0.8, 1.2)],
)


def group(client):
    """Steps of the group of runs below `parent`, with the values that mlflow averages."""
    values = {}
    for run in client.search_runs(["1"], f"tags.`{PARENT_TAG}` = 'parent'"):
        for point in client.get_metric_history(run.info.run_id, "best_fitness"):
            values.setdefault(point.step, []).append(point.value)
    return dict(sorted(values.items()))


def test_the_mean_of_a_group_never_falls(tmp_path):
    uri = f"sqlite:///{tmp_path}/m.db"
    for number, history in enumerate(HISTORIES):
        tracker = MlflowTracker(uri, "lmd")
        tracker.start(RunStart(str(number), tmp_path / str(number), tags={PARENT_TAG: "parent"}))
        tracker.log_curve("best_fitness", curve(history, Budget(400)))
        tracker.finish("FINISHED")
    values = group(MlflowClient(tracking_uri=uri))
    assert {len(each) for each in values.values()} == {3}
    assert list(values)[:6] == [1, 2, 4, 5, 8, 10]
    assert list(values)[-1] == 400
    means = [np.mean(each) for each in values.values()]
    assert all(later >= earlier for earlier, later in pairwise(means))
    assert sorted(values[1]) == [0.05, 0.1, 0.7]  # before its first record a run has the value of that
    assert sorted(values[2]) == [0.05, 0.4, 0.7]
    assert sorted(values[396]) == [0.4, 0.65, 0.8]
    assert sorted(values[400]) == [0.65, 0.8, 0.9]


@pytest.mark.parametrize("history", HISTORIES)
def test_what_is_logged_on_the_way_is_the_beginning_of_the_whole_curve(history):
    whole = curve(history, Budget(400))
    for done, record in enumerate(history):
        part = curve(history[: done + 1], Budget(400), record.evaluations)
        assert [point[:2] for point in part] == [point[:2] for point in whole[: len(part)]]
        assert not part or part[-1][0] <= record.evaluations


def test_seconds_alone_give_steps_of_whole_seconds():
    points = curve(HISTORIES[0], Budget(None, 4.5))
    assert [(step, value) for step, value, _ in points] == [(1, 0.4), (2, 0.4), (3, 0.4), (4, 0.9), (5, 0.9)]
    assert [at for *_, at in points] == [4.0, 4.0, 4.0, 4.0, 4.1]
