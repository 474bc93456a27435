"""`python -m pipelines.estimate_pdf`."""

import json
from pathlib import Path

import processes
import pytest
from composing import composed
from matplotlib.image import imread
from mlflow import MlflowClient
from numpy.testing import assert_allclose
from recordings import MOVING, estimated, simulated

from lmd.orientation.recording import OrientationRecording
from lmd.scene import pdf
from pipelines.nodes import instantiate

ROOT = Path(__file__).parents[2]


def call(*overrides, cwd):
    return processes.inside("estimate_pdf", "hydra.run.dir=run", *overrides, cwd=cwd, settings=())


@pytest.mark.slow
def test_the_command_leaves_a_pdf_that_the_other_pipelines_read(tmp_path):
    simulated(**MOVING).to_csv(tmp_path / "flight.csv")
    done = call("recording.path=flight.csv", "tracking.uri=sqlite:///store.db", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    run = tmp_path / "run"
    assert {path.name for path in run.iterdir()} == {
        ".hydra",
        "pdf.csv",
        "pdf.png",
        "pdf_estimate.json",
    }
    assert imread(run / "pdf.png").shape[:2] == (500, 1500)
    document = json.loads((run / "pdf_estimate.json").read_text())
    assert document["yaw"]["family"] == "von_mises"
    assert [c["family"] for c in document["pitch"]["candidates"]] == ["uniform", "normal", "kernel"]
    assert document["independence"]["rejected"] == (document["form"] == "joint")
    assert document["recording"]["name"] == "flight.csv"

    orientations = pdf.from_csv(str(run / "pdf.csv"))
    direct = estimated(OrientationRecording.from_csv(tmp_path / "flight.csv"), seed=0).pdf
    assert_allclose(orientations.yaw, direct.yaw)
    assert_allclose(orientations.weight, direct.weight)
    read = instantiate(composed("optimise", "pdf=samples", f"pdf.path={run / 'pdf.csv'}").pdf)
    assert_allclose(read.weight, orientations.weight)

    (tracked,) = MlflowClient(tracking_uri=f"sqlite:///{tmp_path}/store.db").search_runs(["1"])
    assert tracked.info.status == "FINISHED"
    assert tracked.data.metrics["samples"] == document["sampling"]["samples"]
    assert tracked.data.metrics["independence/p_value"] == document["independence"]["p_value"]


@pytest.mark.slow
def test_a_recording_that_is_too_short_gets_one_sentence_and_leaves_nothing(tmp_path):
    simulated(duration=20.0).to_csv(tmp_path / "flight.csv")
    done = call("recording.path=flight.csv", cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith("error: flight.csv: 20 s at a mean interval of")
    assert len(done.stderr.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["flight.csv"]


@pytest.mark.slow
def test_a_missing_path_is_named(tmp_path):
    done = call(cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith("error: recording.path is missing")
