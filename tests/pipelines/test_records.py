"""Results that a run keeps however it is stopped; tested in process."""

import csv
import errno
import json
import signal
import time

import numpy as np
import pytest
from omegaconf import OmegaConf
from small import problem

from lmd.optimisers.base import Optimiser
from lmd.optimisers.checkpoint import CHECKPOINT_FILE, Checkpoint
from lmd.optimisers.ega import EGA
from lmd.optimisers.ledger import Budget
from pipelines import outputs, progress, tracked_run
from pipelines.operations.signals import Stopped
from pipelines.operations.tracking.tracker import NoTracker

CFG = OmegaConf.create({"seed": 0, "validate": True, "picture": True, "page": False})


@pytest.fixture(name="found")
def _found(tmp_path, monkeypatch):
    """A run that has spent its budget: its problem, result and keyword arguments of `record`."""
    monkeypatch.setattr(tracked_run, "run_directory", lambda: tmp_path)
    monkeypatch.setattr(tracked_run, "choices", dict)
    p, optimiser = problem(), EGA()
    result = optimiser.run(p, Budget(60))
    Checkpoint(optimiser, {}).save(tmp_path)
    return p, result, {"subject": "ega", "summary": {"evaluations": result.evaluations}}


def record(found, **others):
    p, result, arguments = found
    return tracked_run.record(CFG, p, NoTracker(), result.deployment, result.history, **(arguments | others))


def told_to_stop(*_, **__):
    raise Stopped(signal.SIGTERM)


@pytest.mark.parametrize("where", ["further", "causes", "validation_metrics", "write_pictures"])
def test_a_run_that_is_stopped_while_it_writes_keeps_all_that_cannot_be_had_again(found, where, tmp_path, monkeypatch):
    monkeypatch.setattr(tracked_run, where, told_to_stop, raising=False)
    with pytest.raises(Stopped):
        record(found, **({"further": told_to_stop} if where == "further" else {}), summary={"stopped": "interrupted"})
    assert {"landmarks.csv", "metrics.json", "history.csv", CHECKPOINT_FILE} == {
        path.name for path in tmp_path.iterdir()
    }
    with (tmp_path / "history.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1]["best_fitness"]) == found[1].fitness
    assert int(rows[-1]["evaluations"]) == 60


def test_a_run_that_spent_its_budget_is_finished_though_it_is_stopped_while_it_draws(
    found, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(tracked_run, "write_pictures", told_to_stop)
    monkeypatch.setattr(tracked_run, "command_line", lambda *_: "again")
    ended = []
    monkeypatch.setattr(NoTracker, "finish", lambda _, status, *__: ended.append(status))
    assert record(found)["fitness"] == found[1].fitness
    assert ended == ["FINISHED"]
    assert "warning: told to stop, it has left out pictures; to draw and write again: again" in capsys.readouterr().err
    assert "validation" in json.loads((tmp_path / "metrics.json").read_text())


def test_a_disk_that_is_full_by_then_takes_nothing_back(found, tmp_path, monkeypatch, capsys):
    write = outputs.all_or_none

    def full(directory, fill):
        if (tmp_path / "history.csv").exists():
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(directory, fill)

    monkeypatch.setattr(outputs, "all_or_none", full)
    monkeypatch.setattr(tracked_run, "command_line", lambda *_: "again")
    record(found)
    assert {"landmarks.csv", "metrics.json", "history.csv", CHECKPOINT_FILE} == {
        path.name for path in tmp_path.iterdir()
    }
    assert capsys.readouterr().err.startswith(
        "warning: metrics.json has no validation (No space left on device); scene.png could not be written (No space"
    )


def test_a_method_that_cannot_be_checkpointed_is_named_when_the_run_starts(tmp_path, capsys):
    class Mine(Optimiser):
        def run(self, problem, budget, callback=None):
            raise NotImplementedError

        def found(self, problem):
            return None

    shown = progress.Progress(Budget(9), NoTracker(), Checkpoint(Mine(), {}), tmp_path, 10.0, logged=False)
    warning = "warning: no checkpoint can be written (Mine cannot be checkpointed: it does not say what its state is); "
    assert capsys.readouterr().err.startswith(f"{warning}the run goes on\n")
    shown.flush(Mine())
    shown(Mine())
    assert shown.bar.postfix.startswith("best fitness ")
    shown.close()
    assert "warning" not in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("weight", [1.0, 3.0])
def test_the_fitness_is_printed_where_positions_differ_in_their_relevance(weight, found, monkeypatch, capsys):
    monkeypatch.setattr(tracked_run, "validation_metrics", lambda *_, **__: {})
    p, result, arguments = found
    p.relevance = np.where(np.arange(len(p.relevance)) == 0, weight, p.relevance)
    p.fitness_relevance = p.relevance
    record((p, result, arguments))
    fitness = p.fitness_of(result.deployment)
    weighted = ", in which positions count by their relevance" if weight != 1.0 else ""
    first = capsys.readouterr().out.splitlines()[0].split(maxsplit=1)
    assert first == ["fitness", f"{fitness:.2%}, the qualified ratio{weighted}"]


def test_a_step_is_shown_with_its_parts_once_it_takes_long(monkeypatch, capsys):
    with progress.doing("a short step"):
        pass
    monkeypatch.setattr(progress, "SHOWN_AFTER", 0.2)
    with progress.doing("a long step", 3) as begin_part:
        begin_part()
        begin_part()
        time.sleep(0.6)
    said = capsys.readouterr().err
    assert "short" not in said
    assert "a long step" in said
    assert "1/3" in said
