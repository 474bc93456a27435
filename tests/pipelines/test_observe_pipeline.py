"""`pipelines.observe` as a user meets it: a process, its messages, its exit code and the files it leaves."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import processes
import pytest
from mlflow import MlflowClient

ROOT = Path(__file__).parents[2]
SMALL = ["room.spacing=3", "seeds=2", "trajectory.duration=4", "trajectory.pace.frame_rate=10", "hydra.run.dir=run"]
pytestmark = pytest.mark.slow
NO_DRIFT = ("odometry.turn_noise=0", "odometry.motion_noise=0")
FILES = {"figures.csv", "curves.csv", "observe.md", "paired.csv", "observe.json", "errors.png"}
LANDMARKS = "id,x,y,z,nx,ny,nz\n0,0,1,1,1,0,0\n1,0,2,3,1,0,0\n2,7.5,2,3,-1,0,0\n"


def call(*overrides, cwd, pipeline="observe", settings=SMALL):
    return processes.inside(pipeline, *overrides, cwd=cwd, settings=settings)


@pytest.fixture(scope="module")
def observed(tmp_path_factory):
    cwd = tmp_path_factory.mktemp("work")
    (cwd / "mine.csv").write_text(LANDMARKS)
    done = call("deployment=file,uniform,random", "deployment.path=mine.csv",
                "estimator=[observer,left_observer,bound]", cwd=cwd)  # fmt: skip
    assert done.returncode == 0, done.stderr
    return cwd, done.stdout


def test_a_run_leaves_its_files_and_nothing_else(observed):
    cwd, _ = observed
    assert {path.name for path in (cwd / "run").iterdir()} == {*FILES, ".hydra"}


def test_one_run_compares_the_deployments_over_the_same_flights(observed):
    figures = pd.read_csv(observed[0] / "run" / "figures.csv")
    assert list(figures.deployment.unique()) == ["file", "uniform", "random"]
    assert list(figures.estimator.unique()) == ["observer", "left_observer", "bound"]
    assert sorted(figures.seed.unique()) == [0, 1]
    assert len(figures) == 18
    paired = pd.read_csv(observed[0] / "run" / "paired.csv")
    assert list(zip(paired.estimator, paired.deployment, paired.against, strict=True)) == [
        (estimator, deployment, "file")
        for estimator in ("observer", "left_observer", "bound")
        for deployment in ("uniform", "random")
    ]
    assert (figures[figures.estimator == "observer"].available == 1.0).all()
    curves = pd.read_csv(observed[0] / "run" / "curves.csv")
    first = curves[(curves.estimator == "observer") & (curves.time == 0.0)]
    assert np.ptp(first.error_median) < 1e-9


def test_detector_and_odometry_err_unless_told_to_be_exact(tmp_path):
    near = ("deployment=uniform", "start.position=0", "start.attitude=0", "tracking=none")
    done = call(*near, cwd=tmp_path)
    exact = call(*near, "sensor=exact", *NO_DRIFT, "hydra.run.dir=exact", cwd=tmp_path)
    assert (done.returncode, exact.returncode) == (0, 0), done.stderr + exact.stderr
    errors = [pd.read_csv(tmp_path / run / "figures.csv").position_error.min() for run in ("run", "exact")]
    assert errors[0] > 1e-3 > 1e-9 > errors[1]
    assert "flown with trajectory=random_motion sensor=noisy" in done.stdout
    assert "sensor=exact" in exact.stdout


def test_the_table_is_shown_and_kept(observed):
    cwd, out = observed
    table = (cwd / "run" / "observe.md").read_text()
    assert table in out
    assert len(table.splitlines()) == 11 + 1 + 8  # and each against the first
    assert str(cwd / "run") in out


def test_the_medians_and_settings_are_kept(observed):
    document = json.loads((observed[0] / "run" / "observe.json").read_text())
    figures = pd.read_csv(observed[0] / "run" / "figures.csv")
    mine = figures[(figures.deployment == "uniform") & (figures.estimator == "observer")]
    assert document["medians"]["mean_error/uniform/observer"] == pytest.approx(mine.mean_error.median())
    assert document["seeds"] == [0, 1]
    assert document["settings"]["n"] == 2


def test_mlflow_has_the_run(observed):
    client = MlflowClient(tracking_uri=f"sqlite:///{observed[0]}/outputs/mlflow.db")
    (run,) = client.search_runs([client.get_experiment_by_name("lmd observe").experiment_id])
    assert run.info.status == "FINISHED"
    assert run.data.tags["choice.trajectory"] == "random_motion"
    assert run.data.params["deployments"] == "['file', 'uniform', 'random']"
    assert "share_visible_2/random/observer" in run.data.metrics
    assert len(client.get_metric_history(run.info.run_id, "position_over_time/uniform/observer")) == 41
    assert {*FILES, "config.yaml"} <= {file.path for file in client.list_artifacts(run.info.run_id)}


def test_deployments_can_have_names_and_overrides(tmp_path):
    (tmp_path / "mine.csv").write_text(LANDMARKS)
    entries = "deployments=['best: file deployment.path=mine.csv','few: uniform deployment.count=6',uniform]"
    done = call(entries, "deployment.count=30", "tracking=none", cwd=tmp_path)
    assert done.returncode == 1
    assert "deployment.count = 30, but mine.csv has 3 landmarks" in done.stderr
    done = call(entries, "tracking=none", "seeds=1", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    figures = pd.read_csv(tmp_path / "run" / "figures.csv").set_index("deployment")
    assert list(figures.index) == ["best", "few", "uniform"]
    assert figures.mean_visible["few"] < figures.mean_visible["uniform"]


def test_a_deployment_may_have_a_tag_of_its_own(tmp_path):
    entries = "deployments=['large: uniform tag.edge=0.3','small: uniform tag.edge=0.1']"
    noisy = ["sensor=noisy", "estimator=[pnp,smoother]"]
    done = call(entries, *noisy, "tracking=none", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    figures = pd.read_csv(tmp_path / "run" / "figures.csv").groupby(["deployment", "estimator"]).mean()
    assert figures.mean_visible["large", "pnp"] == pytest.approx(figures.mean_visible["small", "pnp"], rel=0.2)
    assert figures.within_50mm["large", "pnp"] > figures.within_50mm["small", "pnp"]
    assert (figures.within_10mm <= figures.within_20mm).all()


def test_the_motivating_example_flies_twice_over_eighty_random_landmarks(tmp_path):
    settings = [s for s in SMALL if not s.startswith("room.")]
    done = call("experiment=motivating_example", "tracking=none", cwd=tmp_path, settings=settings)
    assert done.returncode == 0, done.stderr
    figures = pd.read_csv(tmp_path / "run" / "figures.csv")
    assert list(figures.deployment.unique()) == ["random", "random all visible"]
    assert (figures[figures.deployment == "random all visible"].mean_visible == 80).all()


def test_evaluate_maps_where_localisation_is_weak(tmp_path):
    settings = ["room.spacing=3", "validate=false", "tracking=none", "hydra.run.dir=run"]
    done = call(cwd=tmp_path, pipeline="evaluate", settings=settings)
    assert done.returncode == 0, done.stderr
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert 0.0 < metrics["pose_fixed_share"] < 1.0
    assert metrics["position_bound_mm_per_pixel"] > 0.0
    assert len(pd.read_csv(tmp_path / "run" / "localisation.csv")) == metrics["settings"]["positions"]
    assert (tmp_path / "run" / "localisation.png").stat().st_size > 30_000
    assert "pose determined" in done.stdout


def test_a_real_detector_reads_rendered_frames(tmp_path):
    camera = ["camera.pixel_width=0.0232", "camera.pixel_height=0.0232", "camera.principal_point=[200,150]",
              "camera.image_width=400", "camera.image_height=300"]  # fmt: skip
    flight = ["seeds=2", "sensor=rendered", "tag.edge=0.3", "workers=2", "tracking=none",
              "trajectory.duration=2"]  # fmt: skip
    done = call("deployment=uniform", *camera, *flight, "estimator=[observer,pnp]", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    figures = pd.read_csv(tmp_path / "run" / "figures.csv")
    by_frame = figures[figures.estimator == "pnp"]
    assert by_frame.mean_visible.max() > 4.0
    assert by_frame.position_error.min() < 0.1
    assert (figures[figures.estimator == "observer"].available == 1.0).all()


def test_a_trajectory_file_is_flown_by_every_seed(tmp_path):
    rows = "".join(f"{0.1 * i:g},{2 + 0.01 * i:g},2,3,{0.02 * i:g},0\n" for i in range(20))
    (tmp_path / "flight.csv").write_text("time,x,y,z,yaw,pitch\n" + rows)
    settings = ["room.spacing=3", "seeds=2", "hydra.run.dir=run", "tracking=none", "deployment=uniform"]
    done = call("trajectory=file", "trajectory.path=flight.csv", "sensor.missed=0", cwd=tmp_path, settings=settings)
    assert done.returncode == 0, done.stderr
    figures = pd.read_csv(tmp_path / "run" / "figures.csv")
    assert figures.mean_visible[0] == figures.mean_visible[1]
    assert figures.mean_error[0] != figures.mean_error[1]
