"""What tells sweeps and experiments apart: experiments of commands, views of their figures, lines of a sweep."""

import base64
import json
import logging
import zlib

import pytest
from mlflow import MlflowClient
from omegaconf import OmegaConf

import pipelines.app  # noqa: F401 # registers resolvers
from pipelines.operations.sweeps.callback import Shortened
from pipelines.operations.sweeps.folder import Sweep, SweepFolder
from pipelines.operations.tracking import MlflowTracker, RunStart


@pytest.mark.parametrize(
    ("command", "experiment"),
    [("optimise", "lmd"), ("evaluate", "lmd"), ("runs", "lmd"), ("report", "lmd"),
     ("survey", "lmd survey"), ("localise", "lmd localise"), ("export", "lmd export"), ("compare", "lmd compare")],
)  # fmt: skip
def test_each_command_records_where_the_docs_say(command, experiment):
    assert OmegaConf.create({"hydra": {"job": {"name": command}}, "at": "${lmd.experiment:}"}).at == experiment


def test_an_experiment_shows_the_figures_of_its_own_runs(tmp_path):
    client, shown = MlflowClient(f"sqlite:///{tmp_path}/m.db"), {}
    for name, figures in (("lmd survey", {"tags": 9, "rms_pixels": 0.3}), ("lmd compare", {"off_grid": 0.5, "x": 1.0})):
        tracker = MlflowTracker(f"sqlite:///{tmp_path}/m.db", name)
        tracker.start(RunStart("run", tmp_path / name))
        tracker.log_metrics(figures)
        tracker.finish("FINISHED")
        view = client.get_experiment_by_name(name).tags["mlflow.sharedViewState.lmd"].removeprefix("deflate;")
        shown[name] = json.loads(zlib.decompress(base64.b64decode(view)))["selectedColumns"]
    assert shown["lmd survey"][-2:] == ["metrics.`tags`", "metrics.`rms_pixels`"]
    assert "metrics.`off_grid`" in shown["lmd compare"]
    assert "metrics.`x`" not in shown["lmd compare"]  # the view of deployments stays
    for column in ("room", "camera", "objective", "budget.evaluations"):
        assert f"params.`{column}`" in shown["lmd compare"]


def test_a_sweep_says_which_one_it_is_like(tmp_path):
    given = {"lab": ("room=lab", "budget.evaluations=60"), "hall": ("room=hall",), "other": ()}
    for name, overrides in given.items():
        varied = ("optimiser",) if name == "other" else ("optimiser", "seed")
        SweepFolder(tmp_path / name).save(Sweep("s", varied, None, given=overrides))
    new = SweepFolder(tmp_path / "new")
    assert new.like(Sweep("s", ("seed", "optimiser"), None, given=("room=hall", "tag=printed"))) == (
        "like hall but for tag=printed"
    )
    assert (
        new.like(Sweep("s", ("optimiser", "seed"), None, given=("room=lab",)))
        == "like lab but for no budget.evaluations=60"
    )
    assert new.like(Sweep("s", ("deployment.count",), None)) == ""


def test_the_line_of_a_job_shows_what_varies():
    record = logging.LogRecord("launcher", logging.INFO, "", 0, "\t#3 : optimiser=ega +seed=1 room=hall", (), None)
    assert Shortened(("optimiser", "seed")).filter(record)
    assert record.getMessage() == "\t#3: optimiser=ega +seed=1"
    started = logging.LogRecord("launcher", logging.INFO, "", 0, "Launching 8 jobs locally", (), None)
    assert Shortened(("optimiser",)).filter(started)
    assert started.getMessage() == "Launching 8 jobs locally"
