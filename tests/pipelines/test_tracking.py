import json
import sys
import tempfile
from pathlib import Path

import psutil
import pytest
from hydra import compose, initialize_config_dir
from mlflow import MlflowClient
from mlflow.store.db import utils
from processes import ensure_warm

import pipelines.sync
from lmd.checks import InputError
from pipelines.app import CONF
from pipelines.sweeps.forks import context
from pipelines.sync import sync
from pipelines.tracking import MlflowReader, MlflowTracker, NoTracker, RunStart
from pipelines.tracking.hand_in import GONE, hand_in
from pipelines.tracking.journal import FILE, Journal
from pipelines.tracking.processes import is_gone, this_process
from pipelines.tracking.store import Store

# mlflow makes its tables anew for each store
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("folder")]


@pytest.fixture(scope="module")
def uri(tmp_path_factory):
    return f"sqlite:///{tmp_path_factory.mktemp('store')}/mlflow.db"


@pytest.fixture(name="folder")
def _folder(tmp_path, monkeypatch):
    """The folder of the runs that a test starts, which do not say where theirs is."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def started(uri, run_id=None, folder=None, **values):
    tracker = MlflowTracker(uri, "tests")
    tracker.start(RunStart("a run", Path(folder or tempfile.mkdtemp(dir=".")), **values), run_id)
    return tracker


def stored(tracker):
    return MlflowClient(tracking_uri=tracker.store.uri).get_run(tracker.run_id)


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
    utils._initialize_tables = sys.modules["warm"].make_tables  # mlflow's own way
    barrier.wait()
    ids.put(started(uri).run_id)


@pytest.mark.slow
def test_eight_processes_that_start_at_once_on_no_database_all_get_a_run(tmp_path):
    ensure_warm()
    barrier, ids = context.Barrier(8), context.Queue()
    arguments = (f"sqlite:///{tmp_path}/fresh.db", barrier, ids)
    processes = [context.Process(target=start_together, args=arguments) for _ in range(8)]
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
    seen = started(uri, tags={"job": "a"})
    seen.finish("FAILED", GONE)  # as another run says of it
    assert MlflowTracker(uri, "tests").end_lost({"job": "a"}, "killed by SIGKILL")
    assert stored(lost).info.status == "FAILED"
    assert stored(lost).data.tags["reason"] == stored(seen).data.tags["reason"] == "killed by SIGKILL"
    assert stored(other).info.status == "RUNNING"
    assert stored(over).info.status == "FINISHED"
    assert not MlflowTracker(uri, "tests").end_lost({"job": "c"}, "killed by SIGKILL")


def test_a_continued_run_forgets_why_it_had_ended(uri):
    first = started(uri)
    first.finish("FAILED", "killed by SIGKILL")
    second = started(uri, run_id=first.run_id)
    second.finish("FINISHED")
    assert "reason" not in stored(second).data.tags


@pytest.fixture(name="reachable")
def _reachable(monkeypatch):
    """A dictionary that says whether stores can be reached."""
    says, send = {"reachable": True}, Store.send

    def sent(self, run_id, entry):
        if not says["reachable"]:
            raise ConnectionError("no route to the store")
        send(self, run_id, entry)

    monkeypatch.setattr(Store, "send", sent)
    return says


def test_a_store_that_is_lost_is_said_once_and_gets_everything_later(uri, folder, reachable, capsys):
    (folder / "landmarks.csv").write_text("id\n")
    tracker = started(uri, folder=folder)
    tracker.log_curve("best_fitness", [(30, 0.25, 1.5)])
    reachable["reachable"] = False
    tracker.log_curve("best_fitness", [(60, 0.5, 3.0)])
    tracker.log_metrics({"fitness": 0.5})
    tracker.log_artifacts([folder / "landmarks.csv"])
    tracker.finish("FINISHED")
    assert capsys.readouterr().err == f"warning: {uri} cannot be used (no route to the store); the run goes on\n"
    assert stored(tracker).info.status == "RUNNING"
    assert f"folder={folder}" in tracker.describe()
    with pytest.raises(InputError, match=r"cannot be used: no route to the store"):
        hand_in(Journal.of(folder), uri)
    reachable["reachable"] = True
    assert "is handed in" in hand_in(Journal.of(folder), uri)
    assert not (folder / FILE).exists()
    run = stored(tracker)
    assert run.info.status == "FINISHED"
    assert run.data.metrics == {"best_fitness": 0.5, "fitness": 0.5}
    client = MlflowClient(tracking_uri=uri)
    assert [(m.step, m.value) for m in client.get_metric_history(tracker.run_id, "best_fitness")] == [
        (30, 0.25),  # sent twice, and there once
        (60, 0.5),
    ]
    assert [file.path for file in client.list_artifacts(tracker.run_id)] == ["landmarks.csv"]


def test_a_store_that_answers_again_gets_everything_at_the_end_of_the_run(uri, folder, reachable):
    tracker = started(uri, folder=folder)
    reachable["reachable"] = False
    tracker.log_metrics({"fitness": 0.5})
    reachable["reachable"] = True
    tracker.log_metrics({"evaluations": 60.0})
    tracker.finish("FINISHED")
    assert stored(tracker).data.metrics == {"fitness": 0.5, "evaluations": 60.0}
    assert not (folder / FILE).exists()


def test_a_journal_cut_short_is_handed_in_without_its_last_line(uri, folder, reachable):
    tracker = started(uri, folder=folder)
    reachable["reachable"] = False
    tracker.log_metrics({"fitness": 0.5})
    tracker.finish("FINISHED")
    whole = (folder / FILE).read_text()
    (folder / FILE).write_text(whole[:-5])
    reachable["reachable"] = True
    assert "its process still runs" in hand_in(Journal.of(folder), uri)  # without the line that ended it
    (folder / FILE).write_text(whole[:-5].replace(this_process()["process"], ANOTHER))
    assert "is handed in" in hand_in(Journal.of(folder), uri)
    assert stored(tracker).data.metrics == {"fitness": 0.5}
    assert stored(tracker).data.tags["reason"] == GONE


def test_what_cannot_be_written_stays_in_the_journal_for_the_next_time(folder):
    journal = Journal.of(folder / "none")
    (folder / "none").write_text("a file where the folder should be")
    journal.add({"metrics": {}})
    (folder / "none").unlink()
    journal.add({"end": "FINISHED"})
    assert Journal.of(folder / "none").entries == [{"metrics": {}}, {"end": "FINISHED"}]


ANOTHER = this_process()["process"].replace(" ", " 1", 1)  # one that had the same number


def test_a_clock_that_is_set_ends_no_living_run(monkeypatch):
    tags = this_process()
    monkeypatch.setattr(psutil.Process, "create_time", lambda _: 0.0)
    assert not is_gone(tags)
    assert is_gone(tags | {"process": ANOTHER})


def test_the_next_run_ends_those_whose_process_is_gone(uri, monkeypatch, capsys):
    alive = started(uri)
    gone = {"host": this_process()["host"], "process": ANOTHER}
    monkeypatch.setattr("pipelines.tracking.mlflow_tracker.this_process", lambda: gone)
    lost = started(uri)  # of another process that had the same number
    monkeypatch.setattr("pipelines.tracking.mlflow_tracker.this_process", lambda: gone | {"host": "elsewhere"})
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


def test_an_experiment_opens_on_its_runs_and_there_is_no_empty_one(folder):
    uri = f"sqlite:///{folder}/mlflow.db"
    started(uri).finish("FINISHED")
    (experiment,) = MlflowClient(tracking_uri=uri).search_experiments()
    assert experiment.name == "tests"
    assert experiment.tags["mlflow.experimentKind"] == "custom_model_development"


@pytest.mark.parametrize("uri", [None, 5, "", "sqlite:///"])
def test_an_address_that_is_none_is_refused(uri):
    with pytest.raises(InputError, match=r"uri must be sqlite:///PATH or the address of a server, got "):
        MlflowTracker(uri, "tests")


def test_a_folder_in_which_no_file_can_be_made_is_named():
    with pytest.raises(InputError, match=r"tracking\.uri = 'sqlite:////proc/mlflow\.db' cannot be used"):
        started("sqlite:////proc/mlflow.db")


def test_no_tracker_records_nothing():
    tracker = NoTracker()
    tracker.start(RunStart("a run", Path()))
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


def test_files_on_a_server_are_not_fetched_for_a_store_that_is_a_file(uri):
    started(uri).finish("FINISHED")
    client = MlflowClient(tracking_uri=uri)
    run = client.create_run(client.create_experiment("evil", artifact_location="http://127.0.0.1:9/files"))
    with pytest.raises(
        InputError, match=r"says that its files are at 'http://127\.0\.0\.1:9/files/.*', from where none"
    ):
        MlflowReader(uri, "tests").artifact(run.info.run_id, "config.yaml")


def journal_of_a_stranger(folder, uri, run_id, *files, host="elsewhere", **begin):
    """A journal as an attacker writes it, of a run that has ended."""
    first = {
        "uri": uri,
        "experiment": "tests",
        "run_id": run_id,
        "folder": str(folder),
        "host": host,
        "process": "1 0.0",
    }
    entries = [first | begin, {"files": [str(file) for file in files]}, {"end": "FINISHED", "reason": "", "at": 0}]
    (folder / FILE).write_text("".join(f"{json.dumps(entry)}\n" for entry in entries))


def synced(*overrides):
    with initialize_config_dir(CONF, version_base="1.3"):
        return sync(compose("sync", ["folder=.", *overrides]))


@pytest.mark.parametrize("link", [False, True])
def test_only_files_of_a_runs_own_folder_are_handed_in(uri, folder, tmp_path_factory, capsys, link):
    secret = tmp_path_factory.mktemp("home") / "id_rsa"
    secret.write_text("secret")
    named = folder / "landmarks.csv" if link else folder / ".." / secret.parent.name / secret.name
    if link:
        named.symlink_to(secret)
    tracker = started(uri)
    journal_of_a_stranger(folder, uri, tracker.run_id, named)
    assert not synced(f"tracking.uri={uri}")
    assert f"would send '{named}', which is not in that folder; `sync --yes` sends it all" in capsys.readouterr().err
    for begin in ({}, {"run_id": tracker.run_id}):  # nor does a run that begins or goes on there send it
        with pytest.raises(InputError, match=r"which is not in that folder"):
            started(uri, folder=folder, **begin)
    client = MlflowClient(tracking_uri=uri)
    assert not client.list_artifacts(tracker.run_id)
    assert synced(f"tracking.uri={uri}", "yes=true")
    assert [file.path for file in client.list_artifacts(tracker.run_id)] == [named.name]


def test_a_journal_goes_to_the_configured_store_or_asks(uri, folder, capsys, monkeypatch):
    asked = []
    monkeypatch.setattr("pipelines.tracking.hand_in.hand_in", lambda _, to: asked.append(to) or "done")
    journal_of_a_stranger(folder, "http://127.0.0.1:9/\x1b[2J", "3f")
    assert not synced(f"tracking.uri={uri}")
    error = capsys.readouterr().err
    assert "it is for 'http://127.0.0.1:9/\\x1b[2J', and not for" in error
    assert "or --yes (docs/trust.md)" in error
    assert not synced("tracking=none")
    assert not asked
    assert synced("uri=http://127.0.0.1:1", f"tracking.uri={uri}")
    assert synced("yes=true", f"tracking.uri={uri}")
    journal_of_a_stranger(folder, uri, "3f")
    assert synced(f"tracking.uri={uri}")
    assert asked == ["http://127.0.0.1:1", "http://127.0.0.1:9/\x1b[2J", uri]


def test_yes_is_an_option(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["sync", "--yes", "folder=x"])
    monkeypatch.setattr("pipelines.sync._main", lambda: None)
    pipelines.sync.main()
    assert sys.argv == ["sync", "yes=true", "folder=x"]


@pytest.mark.parametrize(
    "lines",
    [
        ["[1]"],
        ["5"],
        ['{"files": [3]}'],
        ['{"files": "abc"}'],
        ['{"run_id": 5, "host": [], "process": 1}', '{"end": "FINISHED"}'],
        ['{"run_id": "3f", "uri": "sqlite:///x.db"}', '{"end": 1}'],
    ],
)
def test_a_journal_that_no_run_has_written_is_refused(uri, folder, capsys, lines):
    (folder / FILE).write_text("\n".join(lines))
    assert not synced(f"uri={uri}")
    error = capsys.readouterr().err
    assert error.startswith(f"error: {FILE}: the journal in . is none that a run has written")
    assert error.count("\n") == 1


def test_what_a_store_says_of_a_process_may_be_nonsense():
    for process in ("", "1", "x y", "-1 0", "1 2 3"):
        assert not is_gone({"host": this_process()["host"], "process": process})
