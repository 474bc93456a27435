"""`pipelines.runs`: the list, the command that goes on, and handing in what runs could not record."""

import json

import pandas as pd
import pytest
from mlflow import MlflowClient
from support.processes import inside
from support.stores import ANOTHER, started, stored

from lmd.core.checks import InputError
from lmd.optimisers.checkpoint import CHECKPOINT_FILE
from pipelines.operations.tracking.journal import FILE, GONE, Journal, hand_in, this_process
from pipelines.operations.tracking.store import Store
from pipelines.runs import going_on

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("folder")]
COMMAND = "python -m pipelines.optimise seed=3"


def told(folder, status="KILLED", **tags):
    known = {"command": COMMAND, "folder": str(folder), "host": this_process()["host"]} | tags
    return going_on(pd.Series({"status": status} | {f"tags.{key}": value for key, value in known.items()}))


def test_what_can_go_on_is_shown_with_its_command(tmp_path):
    assert told(tmp_path) == ""  # it has left no checkpoint
    assert told(tmp_path, sweep="seed") == COMMAND
    assert told(tmp_path, sweep="seed", **{"mlflow.parentRunId": "3f"}) == ""  # a job goes on with its sweep
    assert told(tmp_path / "none", sweep="seed") == ""
    (tmp_path / CHECKPOINT_FILE).touch()
    assert told(tmp_path) == f"{COMMAND} resume={tmp_path}"
    assert told(tmp_path, "FINISHED") == ""
    assert told("/no/such/folder", host="elsewhere") == f"{COMMAND} resume=/no/such/folder"


def test_the_newest_runs_are_listed_and_a_stranger_writes_no_escapes(uri, tmp_path):
    (tmp_path / CHECKPOINT_FILE).touch()
    for command in ("python -m pipelines.optimise", "evil\x1b[2J"):
        tags = {"command": command, "folder": str(tmp_path), "pipeline": "optimise"}
        started(uri, folder=tmp_path, tags=tags).finish("KILLED")
    done = inside("runs", f"tracking.uri={uri}", "tracking.experiment_name=tests", "last=2", cwd=tmp_path, settings=())
    assert done.returncode == 0, done.stderr
    assert done.stdout.count(f"resume={tmp_path}") == 2
    assert "evil\\x1b[2J" in done.stdout
    assert "\x1b" not in done.stdout
    refused = inside("runs", "tracking=none", cwd=tmp_path, settings=())
    assert refused.stderr == "error: the list of runs is read from mlflow: set tracking=mlflow.\n"


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
    told = f"warning: tracking.uri = {uri!r} cannot be used: no route to the store; the run goes on\n"
    assert capsys.readouterr().err == told
    assert stored(tracker).info.status == "RUNNING"
    assert tracker.describe().endswith(f"python -m pipelines.runs sync={folder} tracking.uri={uri}")
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


def journal_of_a_stranger(folder, uri, run_id, *files):
    """A journal as an attacker writes it, of a run that has ended."""
    first = {"uri": uri, "experiment": "tests", "run_id": run_id, "folder": str(folder), "host": "elsewhere"}
    entries = [first, {"files": [str(file) for file in files]}, {"end": "FINISHED", "reason": "", "at": 0}]
    (folder / FILE).write_text("".join(f"{json.dumps(entry)}\n" for entry in entries))


def synced(folder, *overrides):
    return inside("runs", "sync=.", *overrides, cwd=folder, settings=())


@pytest.mark.parametrize("link", [False, True])
def test_only_files_of_a_runs_own_folder_are_handed_in(uri, folder, tmp_path_factory, link):
    secret = tmp_path_factory.mktemp("home") / "id_rsa"
    secret.write_text("secret")
    named = folder / "landmarks.csv" if link else folder / ".." / secret.parent.name / secret.name
    if link:
        named.symlink_to(secret)
    tracker = started(uri)
    journal_of_a_stranger(folder, uri, tracker.run_id, named)
    done = synced(folder, f"tracking.uri={uri}")
    assert done.returncode == 1
    assert f"would send '{named}', which is not in that folder" in done.stderr
    for begin in ({}, {"run_id": tracker.run_id}):  # nor does a run that begins or goes on there send it
        with pytest.raises(InputError, match=r"which is not in that folder"):
            started(uri, folder=folder, **begin)
    assert not MlflowClient(tracking_uri=uri).list_artifacts(tracker.run_id)


def test_a_journal_goes_to_the_store_that_the_command_line_names(uri, folder, monkeypatch):
    asked = []
    monkeypatch.setattr("pipelines.operations.tracking.journal.hand_in", lambda _, to: asked.append(to) or "done")
    journal_of_a_stranger(folder, "http://127.0.0.1:9/\x1b[2J", "3f")
    done = synced(folder)
    assert done.returncode == 1
    assert "it was recorded for 'http://127.0.0.1:9/\\x1b[2J': set tracking.uri" in done.stderr
    assert not asked
    assert synced(folder, f"tracking.uri={uri}").returncode == 0
    assert asked == [uri]
    (folder / FILE).unlink()
    assert "nothing to hand in below ." in synced(folder).stdout
    assert "sync = 'none' is not a folder" in inside("runs", "sync=none", cwd=folder, settings=()).stderr


@pytest.mark.parametrize(
    "lines",
    [
        ["[1]"],
        ['{"files": "abc"}'],
        ['{"run_id": 5, "host": [], "process": 1}', '{"end": "FINISHED"}'],
        ['{"run_id": "3f", "uri": "sqlite:///x.db"}', '{"end": 1}'],
    ],
)
def test_a_journal_that_no_run_has_written_is_refused(uri, folder, lines):
    (folder / FILE).write_text("\n".join(lines))
    done = synced(folder, f"tracking.uri={uri}")
    assert done.returncode == 1
    assert done.stderr.startswith(f"error: {FILE}: the journal in . was not written by a run")
    assert done.stderr.count("\n") == 1
