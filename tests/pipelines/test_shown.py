"""What tells sweeps and experiments apart: experiments of commands, views of their figures, lines of a sweep."""

import base64
import json
import zlib

import pytest
from mlflow import MlflowClient
from omegaconf import OmegaConf

import pipelines.app  # noqa: F401 # registers resolvers
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
