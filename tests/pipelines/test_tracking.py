import base64
import json
import sqlite3
import zlib
from pathlib import Path

import psutil
import pytest
from mlflow import MlflowClient
from support.stores import ANOTHER, started, stored

from lmd.core.checks import InputError
from pipelines.operations.tracking import MlflowReader, MlflowTracker, RunStart
from pipelines.operations.tracking.journal import GONE, is_gone, this_process
from pipelines.operations.tracking.store import DESCRIPTION

pytestmark = pytest.mark.usefixtures("folder")


def test_a_run_keeps_its_params_tags_metrics_and_name(uri):
    tracker = started(uri, params={"room.size": [1, 2, 3], "seed": 0}, tags={"choice.room": "hall"})
    tracker.log_metrics({"qualified_ratio": 0.5})
    tracker.finish("FINISHED")
    run = stored(tracker)
    assert run.data.params == {"room.size": "[1, 2, 3]", "seed": "0"}
    assert run.data.tags["choice.room"] == "hall"
    assert run.data.metrics == {"qualified_ratio": 0.5}
    assert run.info.run_name == f"a run #{tracker.run_id[:4]}"
    assert run.info.status == "FINISHED"


def test_a_failed_run_says_why(uri):
    tracker = started(uri, tags={DESCRIPTION: "about\n\nthis"})
    tracker.finish("FAILED", "ValueError: no")
    assert stored(tracker).info.status == "FAILED"
    assert stored(tracker).data.tags["reason"] == "ValueError: no"
    assert stored(tracker).data.tags[DESCRIPTION] == "**FAILED**: ValueError: no\n\nabout\n\nthis"
    again = started(uri, run_id=tracker.run_id)
    assert stored(again).data.tags[DESCRIPTION] == "about\n\nthis"


def test_an_experiment_that_was_deleted_says_how_to_restore_it(uri):
    run = started(uri)
    client, experiment = run.store.client, run.store.experiment_id
    client.delete_experiment(experiment)
    try:
        again = (
            rf"'tests' was deleted in mlflow: `MLFLOW_TRACKING_URI={uri} mlflow experiments restore -x {experiment}`"
        )
        with pytest.raises(InputError, match=again):
            MlflowReader(uri, "tests")
    finally:
        client.restore_experiment(experiment)
    run.discard()
    assert started(uri, run.run_id).run_id != run.run_id  # another one, as it was deleted
    assert not MlflowTracker(uri, "tests").goes_on(stored(started(uri)).info.run_id[::-1], Path(), {})


def test_a_store_that_cannot_be_written_is_one_sentence(tmp_path, capfd):
    store = started(f"sqlite:///{tmp_path}/mlflow.db").store
    with sqlite3.connect(tmp_path / "mlflow.db") as database:
        database.execute("CREATE TRIGGER no BEFORE INSERT ON runs BEGIN SELECT RAISE(ABORT, 'may not be written'); END")
    with pytest.raises(InputError, match=r"mlflow\.db' cannot be used: \(sqlite3\.\w+\) may not be written$"):
        started(store.uri)
    assert capfd.readouterr() == ("", "")


def settled(uri, job, *arguments):
    MlflowTracker(uri, "tests").settle(RunStart("b", Path("b"), {"seed": 3}, {"job": job}), *arguments)
    client = MlflowClient(tracking_uri=uri)
    return client.search_runs([client.get_experiment_by_name("tests").experiment_id], f"tags.job = '{job}'")


def test_of_what_a_dead_process_left_the_newest_run_stays_and_is_ended(uri, folder):
    lost, other = started(uri, tags={"job": "a"}), started(uri, tags={"job": "b"})
    seen = started(uri, tags={"job": "a"})
    seen.finish("FAILED", GONE)  # as another run says of it
    (folder / "output.log").write_text("said")
    (run,) = settled(uri, "a", "FAILED", "killed by SIGKILL", [folder / "output.log"])
    assert (run.info.run_id, run.data.tags["reason"]) == (seen.run_id, "killed by SIGKILL")
    assert [file.path for file in MlflowClient(tracking_uri=uri).list_artifacts(seen.run_id)] == ["output.log"]
    assert (stored(lost).info.status, stored(lost).info.lifecycle_stage) == ("FAILED", "deleted")
    assert stored(other).info.status == "RUNNING"
    (made,) = settled(uri, "c", "FAILED", "killed by SIGKILL")  # it began none
    assert (made.info.status, made.data.params) == ("FAILED", {"seed": "3"})
    assert settled(uri, "d", "FINISHED") == []


def test_a_clock_that_is_set_ends_no_living_run(monkeypatch):
    tags = this_process()
    monkeypatch.setattr(psutil.Process, "create_time", lambda _: 0.0)
    assert not is_gone(tags)
    assert is_gone(tags | {"process": ANOTHER})
    for nonsense in ("", "1", "x y", "-1 0", "1 2 3"):  # a store may hold anything
        assert not is_gone(tags | {"process": nonsense})


def test_the_next_run_ends_those_whose_process_is_gone(uri, monkeypatch, capsys):
    alive = started(uri)
    gone = {"host": this_process()["host"], "process": ANOTHER}
    process = "pipelines.operations.tracking.mlflow_tracker.this_process"
    monkeypatch.setattr(process, lambda: gone)
    lost = started(uri)  # of another process that had the same number
    monkeypatch.setattr(process, lambda: gone | {"host": "elsewhere"})
    elsewhere = started(uri)
    monkeypatch.undo()
    started(uri).finish("FINISHED")
    assert stored(lost).info.status == "FAILED"
    assert stored(lost).data.tags["reason"] == GONE
    assert stored(alive).info.status == stored(elsewhere).info.status == "RUNNING"
    assert GONE in capsys.readouterr().err


def test_a_run_goes_on_only_where_it_stays_one_history(uri, folder):
    tracker = started(uri, folder=folder, params={"seed": 0})
    tracker.finish("KILLED")
    assert tracker.goes_on(tracker.run_id, folder, {"seed": 0})
    assert not tracker.goes_on(tracker.run_id, folder, {"seed": 1})
    assert not tracker.goes_on(tracker.run_id, folder / "another", {"seed": 0})
    second = started(uri, tracker.run_id, folder / "second", params={"seed": 0})
    assert not tracker.goes_on(tracker.run_id, folder, {"seed": 0})  # went on in the second folder
    second.finish("FINISHED")
    assert not tracker.goes_on(tracker.run_id, folder / "second", {"seed": 0})


def state_of(client, name="lmd"):
    """The state of mlflow's page that a shared view has."""
    shared = client.get_experiment_by_name("tests").tags[f"mlflow.sharedViewState.{name}"]
    return json.loads(zlib.decompress(base64.b64decode(shared.removeprefix("deflate;"))))


def test_the_pages_of_an_experiment_and_of_a_sweep_show_its_figures(folder):
    uri = f"sqlite:///{folder}/mlflow.db"
    client, tracker = MlflowClient(tracking_uri=uri), started(uri)
    assert {"metrics.`off_grid`", "metrics.`best/off_grid`", "params.`room`"} <= {*state_of(client)["selectedColumns"]}
    assert state_of(client)["columnWidths"] == {"attributes.`Run Name`": 280}
    table, charts = tracker.views(["optimiser"])
    assert f"viewStateShareKey={tracker.run_id}" in table
    assert "compareRunsMode=CHART" in charts
    view = state_of(client, tracker.run_id)
    assert view["groupBy"]["groupByKeys"] == [{"mode": "param", "groupByData": "optimiser"}]
    assert view["columnOrder"][1:4] == ["params.`optimiser`", "params.`seed`", "metrics.`off_grid`"]
    assert [chart["metricKey"] for chart in view["compareRunCharts"]] == ["best_fitness", "fitness", "off_grid"]
    tracker.log_metrics({"tags": 3.0})
    tracker.finish("FINISHED")
    assert "metrics.`tags`" in state_of(client)["selectedColumns"]  # no figure of deployments


def test_the_problem_of_a_run_is_a_dataset(uri):
    tracker = started(uri, dataset=("hall n=2 K=40", "3f2a"))
    (given,) = stored(tracker).inputs.dataset_inputs
    assert (given.dataset.name, given.dataset.digest) == ("hall n=2 K=40", "3f2a")


@pytest.mark.parametrize("uri", [None, 5, "", "sqlite:///"])
def test_an_address_that_is_none_is_refused(uri):
    with pytest.raises(InputError, match=r"uri must be sqlite:///PATH or the address of a server, got "):
        MlflowTracker(uri, "tests")


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
    assert reader.artifact(ids[0], "landmarks.csv").read_text() == "id\n"


def test_reading_makes_no_store_and_names_what_is_missing(recorded, tmp_path):
    uri, ids = recorded
    with pytest.raises(InputError, match=r"there is no file '.*none\.db'"):
        MlflowReader(f"sqlite:///{tmp_path}/none.db", "tests")
    assert not (tmp_path / "none.db").exists()
    with pytest.raises(InputError, match="has no experiment called 'other'"):
        MlflowReader(uri, "other")
    with pytest.raises(InputError, match=r"has no file 'none\.csv'"):
        MlflowReader(uri, "tests").artifact(ids[0], "none.csv")


def test_files_on_a_server_are_not_fetched_for_a_store_that_is_a_file(uri):
    started(uri).finish("FINISHED")
    client = MlflowClient(tracking_uri=uri)
    run = client.create_run(client.create_experiment("evil", artifact_location="http://127.0.0.1:9/files"))
    with pytest.raises(InputError, match=r"has its files at 'http://127\.0\.0\.1:9/files/.*', but only local"):
        MlflowReader(uri, "tests").artifact(run.info.run_id, "config.yaml")
