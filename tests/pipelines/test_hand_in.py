"""Entries that a store missed are handed in later; journals of unknown origin are refused."""

import json
import sys

import pytest
from composing import composed
from mlflow import MlflowClient
from recorded_runs import ANOTHER, started, stored

import pipelines.sync
from lmd.core.checks import InputError
from pipelines.operations.tracking.journal import FILE, GONE, Journal, hand_in, this_process
from pipelines.operations.tracking.store import Store
from pipelines.sync import sync

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("folder")]


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
    return sync(composed("sync", "folder=.", *overrides))


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
    monkeypatch.setattr("pipelines.operations.tracking.journal.hand_in", lambda _, to: asked.append(to) or "done")
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
    pipelines.sync.read_yes()
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
