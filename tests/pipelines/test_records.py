"""Results that a run keeps however it is stopped; commands run in this process."""

import csv
import errno
import json
import signal
import time

import pytest
from support.processes import inside

from lmd.optimisers.base import Optimiser
from lmd.optimisers.checkpoint import CHECKPOINT_FILE, Checkpoint
from lmd.optimisers.ledger import Budget
from pipelines import app, outputs, progress
from pipelines.operations.signals import Stopped
from pipelines.operations.tracking import NoTracker

SMALL = ("room.spacing=2", "objective.thold_p=0.1", "objective.n=1", "deployment.count=6", "optimiser=ega",
         "budget.evaluations=60", "tracking=none", "hydra.run.dir=run")  # fmt: skip
KEPT = {"landmarks.csv", "metrics.json", "history.csv", CHECKPOINT_FILE}
DRAWN = {"room.png", ".hydra"}
pytestmark = pytest.mark.slow


@pytest.fixture(name="ended")
def _ended(monkeypatch):
    """How the tracked run ends."""
    statuses = []
    monkeypatch.setattr(NoTracker, "finish", lambda _, status, *__: statuses.append(status))
    return statuses


def run(cwd, *overrides):
    return inside("optimise", *SMALL, *overrides, cwd=cwd, settings=())


def left(cwd):
    return {path.name for path in (cwd / "run").iterdir()} - DRAWN


def told_to_stop(*_, **__):
    raise Stopped(signal.SIGTERM)


@pytest.mark.parametrize(
    "where", ["lmd.evaluation.verdicts.causes", "lmd.evaluation.validation.validation_metrics"],
)  # fmt: skip
def test_a_run_that_is_stopped_while_it_scores_keeps_all_that_cannot_be_had_again(where, ended, tmp_path, monkeypatch):
    monkeypatch.setattr(where, told_to_stop)
    done = run(tmp_path)
    assert left(tmp_path) == KEPT
    with (tmp_path / "run" / "history.csv").open() as file:
        rows = list(csv.DictReader(file))
    figures = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert (float(rows[-1]["best_fitness"]), rows[-1]["evaluations"]) == (figures["fitness"], "60")
    assert ended == ["FINISHED"]  # it has spent its budget
    again = "it was told to stop and has left out the rest; to write the files again: python -m pipelines.evaluate run="
    assert again in done.stderr


def test_a_run_that_is_stopped_while_it_draws_has_its_figures(ended, tmp_path, monkeypatch):
    monkeypatch.setattr("lmd.plot.scenes.save_scene_figure", told_to_stop)
    done = run(tmp_path)
    assert (ended, left(tmp_path)) == (["FINISHED"], KEPT)
    assert "validation" in json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert "and has left out the rest" in done.stderr


def test_a_disk_that_is_full_by_then_takes_nothing_back(ended, tmp_path, monkeypatch):
    write = outputs.all_or_none

    def full(directory, fill):
        if (tmp_path / "run" / "history.csv").exists():
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(directory, fill)

    monkeypatch.setattr(outputs, "all_or_none", full)
    done = run(tmp_path)
    assert (ended, left(tmp_path)) == (["FINISHED"], KEPT)
    for name in ("metrics.json", "scene.png", "convergence.png"):
        assert f"{name} could not be written (No space left on device)" in done.stderr


def test_a_method_that_cannot_be_checkpointed_is_named_when_the_run_starts(tmp_path, capsys):
    class Mine(Optimiser):
        def run(self, problem, budget, callback=None):
            raise NotImplementedError

        def found(self, problem):
            return None

    shown = progress.Progress(Budget(9), NoTracker(), Checkpoint(Mine(), {}), tmp_path, 10.0, logged=False)
    warning = "warning: no checkpoint can be written (Mine cannot be checkpointed: it has no state to be saved); "
    assert capsys.readouterr().err.startswith(f"{warning}the run goes on\n")
    shown.flush(Mine())
    shown(Mine())
    assert shown.bar.postfix.startswith("best fitness ")
    shown.close()
    assert "warning" not in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_step_is_shown_once_it_takes_long(monkeypatch, capsys):
    with app.doing("a short step"):
        pass
    monkeypatch.setattr(app, "SHOWN_AFTER", 0.2)
    with app.doing("a long step"):
        time.sleep(0.6)
    said = capsys.readouterr().err
    assert "short" not in said
    assert said == "a long step ...\n"
