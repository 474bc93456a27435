import multiprocessing

import pytest
from mlflow import MlflowClient

from lmd.checks import InputError
from pipelines.tracking import MlflowReader, MlflowTracker, NoTracker

pytestmark = pytest.mark.slow  # mlflow makes its tables anew for each store


@pytest.fixture(scope="module")
def uri(tmp_path_factory):
    return f"sqlite:///{tmp_path_factory.mktemp('store')}/mlflow.db"


def started(uri, **values):
    tracker = MlflowTracker(uri, "tests")
    tracker.start("a run", values.get("params", {}), values.get("tags", {}), values.get("run_id"))
    return tracker


def stored(tracker):
    return MlflowClient(tracking_uri=tracker.uri).get_run(tracker.run_id)


def test_a_run_keeps_its_params_tags_metrics_and_name(uri):
    tracker = started(uri, params={"room.size": [1, 2, 3], "seed": 0}, tags={"choice.room": "hall"})
    tracker.log_metrics({"qualified_ratio": 0.5})
    tracker.finish("FINISHED")
    run = stored(tracker)
    assert run.data.params == {"room.size": "[1, 2, 3]", "seed": "0"}
    assert run.data.tags["choice.room"] == "hall"
    assert run.data.metrics == {"qualified_ratio": 0.5}
    assert run.info.run_name == "a run"
    assert run.info.status == "FINISHED"


def test_a_long_curve_is_logged_whole(uri):
    tracker = started(uri)
    tracker.log_curve("best_fitness", [(i, i / 2500, i * 0.001) for i in range(2500)])
    history = MlflowClient(tracking_uri=uri).get_metric_history(tracker.run_id, "best_fitness")
    assert sorted(m.step for m in history) == list(range(2500))


def test_artifacts_are_kept_beside_the_database(uri, tmp_path):
    (tmp_path / "landmarks.csv").write_text("id\n")
    tracker = started(uri)
    tracker.log_artifacts([tmp_path / "landmarks.csv"])
    assert [f.path for f in MlflowClient(tracking_uri=uri).list_artifacts(tracker.run_id)] == ["landmarks.csv"]
    assert str(stored(tracker).info.artifact_uri).startswith("file://")


def test_a_run_can_be_continued(uri):
    first = started(uri, params={"seed": 0})
    first.finish("KILLED")
    second = started(uri, run_id=first.run_id, params={"seed": 0})
    second.log_metrics({"fitness": 1.0})
    second.finish("FINISHED")
    assert second.run_id == first.run_id
    assert stored(second).info.status == "FINISHED"


def test_a_failed_run_says_why(uri):
    tracker = started(uri)
    tracker.finish("FAILED", "ValueError: no")
    assert stored(tracker).info.status == "FAILED"
    assert stored(tracker).data.tags["reason"] == "ValueError: no"


def test_a_run_that_never_started_can_be_finished(uri):
    MlflowTracker(uri, "tests").finish("FAILED")


def test_a_store_that_cannot_be_used_is_named():
    with pytest.raises(InputError, match=r"tracking\.uri = 'sqlite:////proc/none/mlflow\.db' cannot be used"):
        started("sqlite:////proc/none/mlflow.db")


def start_together(uri, barrier, ids):
    barrier.wait()
    ids.put(started(uri).run_id)


@pytest.mark.slow
def test_eight_processes_that_start_at_once_on_no_database_all_get_a_run(tmp_path):
    fresh = multiprocessing.get_context("forkserver")
    fresh.set_forkserver_preload(["mlflow.store.tracking.sqlalchemy_store"])  # imported once, and not eight times
    barrier, ids = fresh.Barrier(8), fresh.Queue()
    arguments = (f"sqlite:///{tmp_path}/fresh.db", barrier, ids)
    processes = [fresh.Process(target=start_together, args=arguments) for _ in range(8)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0] * 8
    assert len({ids.get(timeout=10) for _ in processes}) == 8


def test_what_a_dead_process_left_running_is_ended(uri):
    lost, other = started(uri, tags={"job": "a"}), started(uri, tags={"job": "b"})
    over = started(uri, tags={"job": "a"})
    over.finish("FINISHED")
    assert MlflowTracker(uri, "tests").end_lost({"job": "a"}, "killed by SIGKILL")
    assert stored(lost).info.status == "FAILED"
    assert stored(lost).data.tags["reason"] == "killed by SIGKILL"
    assert stored(other).info.status == "RUNNING"
    assert stored(over).info.status == "FINISHED"
    assert not MlflowTracker(uri, "tests").end_lost({"job": "c"}, "killed by SIGKILL")


def test_a_continued_run_forgets_why_it_had_ended(uri):
    first = started(uri)
    first.finish("FAILED", "killed by SIGKILL")
    second = started(uri, run_id=first.run_id)
    second.finish("FINISHED")
    assert "reason" not in stored(second).data.tags


def test_no_tracker_records_nothing():
    tracker = NoTracker()
    tracker.start("a run", {}, {}, None)
    tracker.log_metrics({"fitness": 1.0})
    assert tracker.run_id is None
    assert "tracking=none" in tracker.describe()


@pytest.fixture(name="recorded")
def _recorded(tmp_path):
    """A store of its own with two runs, the first with a curve and a file; their ids."""
    uri = f"sqlite:///{tmp_path}/mlflow.db"
    (tmp_path / "landmarks.csv").write_text("id\n")
    trackers = [started(uri, params={"seed": seed}, tags={"choice.room": "hall"}) for seed in range(2)]
    trackers[0].log_curve("best_fitness", [(30, 0.25, 1.5), (60, 0.5, 3.0)])
    trackers[0].log_metrics({"qualified_ratio": 0.5})
    trackers[0].log_artifacts([tmp_path / "landmarks.csv"])
    trackers[0].finish("FINISHED")
    return uri, [tracker.run_id for tracker in trackers]


def test_what_was_recorded_can_be_read(recorded):
    uri, ids = recorded
    reader = MlflowReader(uri, "tests")
    runs = reader.runs()
    assert list(runs.index) == ids
    assert list(runs["params.seed"]) == ["0", "1"]
    assert list(runs["tags.choice.room"]) == ["hall", "hall"]
    assert list(runs["status"]) == ["FINISHED", "RUNNING"]
    assert runs.loc[ids[0], "metrics.qualified_ratio"] == 0.5
    assert runs["metrics.qualified_ratio"].isna()[ids[1]]
    assert reader.curve(ids[0], "best_fitness") == [(30, 0.25, 1.5), (60, 0.5, 3.0)]
    assert reader.curve(ids[1], "best_fitness") == []
    assert reader.artifact(ids[0], "landmarks.csv").read_text() == "id\n"


def test_more_runs_than_fit_a_page_are_read(recorded, monkeypatch):
    uri, ids = recorded
    search = MlflowClient.search_runs
    monkeypatch.setattr(MlflowClient, "search_runs", lambda *args, **kwargs: search(*args, **kwargs, max_results=1))
    assert list(MlflowReader(uri, "tests").runs().index) == ids


def test_reading_makes_no_store_and_names_what_is_missing(recorded, tmp_path):
    uri, ids = recorded
    with pytest.raises(InputError, match=r"there is no file '.*none\.db'"):
        MlflowReader(f"sqlite:///{tmp_path}/none.db", "tests")
    assert not (tmp_path / "none.db").exists()
    with pytest.raises(InputError, match="has no experiment called 'other'"):
        MlflowReader(uri, "other")
    with pytest.raises(InputError, match=r"has no file 'none\.csv'"):
        MlflowReader(uri, "tests").artifact(ids[0], "none.csv")
