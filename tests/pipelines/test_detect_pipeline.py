"""`pipelines.detect` as a user meets it: a process, its messages, its exit code and the files it leaves."""

import json
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import processes
import pytest
from mlflow import MlflowClient

ROOT = Path(__file__).parents[2]
CLEAN = ("+imaging.psf_sigma=0.4", "+imaging.defocus=false", "+imaging.noise=0", "imaging.texture=0")
CAMERA = ["camera.pixel_width=0.0116", "camera.pixel_height=0.0116", "camera.principal_point=[400,300]",
          "camera.image_width=800", "camera.image_height=600"]  # fmt: skip
SMALL = ["room.spacing=3", *CAMERA, "tag.edge=0.3", "poses=24", "pictures=1", "hydra.run.dir=run"]
FILES = {"detect.md", "figures.csv", "pitches.csv", "tags.csv", "detect.json", "calibration.png", "frames"}
LANDMARKS = "id,x,y,z,nx,ny,nz\n0,0,2,3,1,0,0\n1,0,3,3,1,0,0\n2,7.5,2,3,-1,0,0\n"
pytestmark = pytest.mark.slow


def call(*overrides, cwd, settings=SMALL):
    return processes.inside("detect", *overrides, cwd=cwd, settings=settings)


@pytest.fixture(scope="module")
def detected(tmp_path_factory):
    cwd = tmp_path_factory.mktemp("work")
    (cwd / "mine.csv").write_text(LANDMARKS)
    done = call("deployments=[uniform,'mine: file deployment.path=mine.csv']", "detectors=[aruco,apriltag_decimate2]",
                "workers=2", cwd=cwd)  # fmt: skip
    assert done.returncode == 0, done.stderr
    return cwd, done.stdout


def figures_of(cwd):
    return pd.read_csv(cwd / "run" / "figures.csv").set_index(["deployment", "detector"])


def test_a_run_leaves_its_files_and_nothing_else(detected):
    cwd, _ = detected
    assert {path.name for path in (cwd / "run").iterdir()} == {*FILES, ".hydra"}
    assert {path.name for path in (cwd / "run" / "frames").iterdir()} == {"uniform_0.png", "mine_0.png"}
    assert cv2.imread(str(cwd / "run" / "frames" / "mine_0.png")).shape == (600, 800, 3)
    assert (cwd / "run" / "calibration.png").stat().st_size > 20_000


def test_a_row_for_each_deployment_and_detector(detected):
    figures = figures_of(detected[0])
    assert list(figures.index) == [
        (deployment, detector) for deployment in ("uniform", "mine") for detector in ("aruco", "apriltag_decimate2")
    ]
    assert (figures.frames == 24).all()
    assert figures.tags.tolist() == [90, 90, 3, 3]
    for n in range(1, 5):
        share, error = figures[f"detected_{n}"], figures[f"detected_{n}_error"]
        np.testing.assert_allclose(error, np.sqrt(share * (1.0 - share) / 24))
    assert (np.diff(figures[[f"detected_{n}" for n in range(1, 5)]].to_numpy(), axis=1) <= 0).all()
    assert (figures.predicted_1.uniform == figures.predicted_1.uniform.iloc[0]).all()
    assert figures.detected_1["uniform", "aruco"] > 0.9
    # Wide tags that a detector finds where the paper's model, which knows no size, does not expect them.
    assert figures.left_out["uniform", "aruco"] > figures.overrated["uniform", "aruco"]
    assert figures.left_out_resolution["uniform", "aruco"] > 0
    assert figures.corner_median["uniform", "aruco"] < 1.0
    assert figures.position_median["uniform", "aruco"] < 0.05


def test_classes_of_pitch_and_tags(detected):
    pitches, tags = (pd.read_csv(detected[0] / "run" / f"{name}.csv") for name in ("pitches", "tags"))
    large = pitches[(pitches.deployment == "uniform") & (pitches.detector == "aruco") & (pitches.pitch_from >= 3.0)]
    assert (large.detected > 0.9).all()
    assert len(tags) == 2 * 93
    found = tags[(tags.deployment == "uniform") & (tags.detector == "aruco")]
    assert (found.id == np.arange(90)).all()
    assert not found.overlapping.any()


def test_the_table_is_shown_and_kept(detected):
    cwd, out = detected
    table = (cwd / "run" / "detect.md").read_text()
    assert table in out
    assert len(table.splitlines()) == 13
    assert "of these fail field of view" in table


def test_mlflow_has_the_run(detected):
    client = MlflowClient(tracking_uri=f"sqlite:///{detected[0]}/outputs/mlflow.db")
    (run,) = client.search_runs([client.get_experiment_by_name("lmd detect").experiment_id])
    assert run.info.status == "FINISHED"
    document = json.loads((detected[0] / "run" / "detect.json").read_text())
    assert run.data.metrics["detected_2/mine/aruco"] == document["figures"]["detected_2/mine/aruco"]
    assert {"detect.md", "figures.csv", "calibration.png", "mine_0.png"} <= {
        file.path for file in client.list_artifacts(run.info.run_id)
    }


def test_any_number_of_workers_gives_the_same(detected, tmp_path):
    done = call("deployment=uniform", "workers=1", "pictures=0", "tracking=none", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    alone, before = figures_of(tmp_path), figures_of(detected[0])
    pd.testing.assert_series_equal(alone.loc["uniform", "aruco"], before.loc["uniform", "aruco"])
    assert not (tmp_path / "run" / "frames").exists()


def test_a_deployment_may_have_a_tag_of_its_own(tmp_path):
    entries = "deployments=[uniform,'tiny: uniform tag.edge=0.02']"
    done = call(
        entries,
        *CLEAN,
        "pictures=0",
        "poses=12",
        "nudge=[0,0]",
        "tracking=none",
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    figures = figures_of(tmp_path)
    assert figures.predicted_2["uniform", "aruco"] == figures.predicted_2["tiny", "aruco"]
    assert figures.detected_2["uniform", "aruco"] > 0.9 > 0.1 > figures.detected_2["tiny", "aruco"]
    # Looked at again from the same poses, without noise.
    assert (figures.repeated_2 == 1.0).all()
    assert figures.repeated_tags["uniform", "aruco"] == 1.0
    assert "| 100.0% | 100.0% |" in done.stdout


def test_frames_without_a_tag_have_empty_tables(tmp_path):
    (tmp_path / "one.csv").write_text("id,x,y,z,nx,ny,nz\n0,0,0.5,0.5,1,0,0\n")
    one = ["deployment=file", "deployment.path=one.csv", "objective.n=1", "poses=2", "pictures=0", "tracking=none"]
    done = call(*one, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert figures_of(tmp_path).predicted_1.to_list() == [0.0]
    pitches = (tmp_path / "run" / "pitches.csv").read_text()
    assert pitches == "deployment,detector,pitch_from,pitch_to,tags,predicted,detected,corner_median,corner_90\n"
