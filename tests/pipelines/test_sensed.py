"""Flights and rendered images: deployments with names and overrides of their own, real detectors, a crowd."""

import json

import numpy as np
import pandas as pd
import pytest
from support import processes
from support.composing import composed

from lmd.detection.frames import draw_crowd, draw_poses
from pipelines.building import build_problem

pytestmark = pytest.mark.slow
CAMERA = ["camera.pixel_width=0.0232", "camera.pixel_height=0.0232", "camera.principal_point=[200,150]",
          "camera.image_width=400", "camera.image_height=300"]  # fmt: skip
SMALL = ["room.spacing=3", "tracking=none", "hydra.run.dir=run"]
SIZES = "deployments=['large: uniform tag.edge=0.3','small: uniform tag.edge=0.1']"
LAB = "experiment=lab", "deployment=uniform", "room.spacing=1.5"


def conduct(study, *overrides, cwd, settings=SMALL):
    done = processes.inside("evaluate", f"studies=[{study}]", *overrides, cwd=cwd, settings=settings)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_flights_compare_deployments_with_tags_of_their_own(tmp_path):
    words = ("sensor=noisy", "estimator=[pnp,smoother]", "tag.edge=0.1", "seeds=2", "trajectory.duration=2")
    conduct("observe", SIZES, *words, cwd=tmp_path)
    figures = pd.read_csv(tmp_path / "run" / "figures.csv").groupby(["deployment", "estimator"]).mean()
    assert figures.within_50mm["large", "pnp"] > figures.within_50mm["small", "pnp"]
    document = json.loads((tmp_path / "run" / "observe.json").read_text())
    assert (document["seeds"], document["settings"]["n"]) == ([0, 1], 2)


def test_exact_measurements_leave_no_error(tmp_path):
    exact = (
        "sensor.pixel_noise=0",
        "sensor.missed=0",
        "odometry.turn_noise=0",
        "odometry.motion_noise=0",
        "start.position=0",
        "start.attitude=0",
    )
    told = conduct("observe", *exact, "seeds=1", "trajectory.duration=2", cwd=tmp_path)
    assert pd.read_csv(tmp_path / "run" / "figures.csv").position_error.max() < 1e-9
    assert "simulated with trajectory=random_motion sensor=noisy" in told


def test_a_real_detector_reads_frames_of_a_flight(tmp_path):
    words = ("sensor=rendered", "tag.edge=0.3", "workers=2", "seeds=2", "trajectory.duration=2", "estimator=[pnp]")
    conduct("observe", *CAMERA, *words, cwd=tmp_path)
    figures = pd.read_csv(tmp_path / "run" / "figures.csv")
    assert figures.mean_visible.max() > 4.0
    assert figures.position_error.min() < 0.1


def test_the_motivating_example_flies_twice_over_eighty_random_landmarks(tmp_path):
    words = ("experiment=motivating_example", "seeds=1", "trajectory.duration=2", "tracking=none", "hydra.run.dir=run")
    conduct("observe", *words, cwd=tmp_path, settings=())
    figures = pd.read_csv(tmp_path / "run" / "figures.csv")
    assert list(figures.deployment.unique()) == ["random", "random all visible"]
    assert (figures[figures.deployment == "random all visible"].mean_visible == 80).all()


def test_detectors_find_what_is_near(tmp_path):
    clean = ("imaging.psf_sigma=0.4", "imaging.defocus=false", "imaging.noise=0", "imaging.texture=0")
    words = ("deployments=[uniform,'tiny: uniform tag.edge=0.02']", "tag.edge=0.3", "frames=12")
    conduct("detect", *clean, *words, "pictures=0", cwd=tmp_path)
    figures = pd.read_csv(tmp_path / "run" / "figures.csv").set_index(["deployment", "detector"])
    assert figures.detected_2["uniform", "aruco"] > figures.detected_2["tiny", "aruco"]
    document = json.loads((tmp_path / "run" / "detect.json").read_text())
    assert document["figures"]["detected_2/uniform/aruco"] == figures.detected_2["uniform", "aruco"]


def test_frames_without_a_tag_have_empty_tables(tmp_path):
    (tmp_path / "one.csv").write_text("id,x,y,z,nx,ny,nz\n0,0,0.5,0.5,1,0,0\n")
    words = ("deployment.path=one.csv", "tag.edge=0.3", "objective.n=1", "frames=2", "pictures=0")
    conduct("detect", *words, cwd=tmp_path)
    pitches = (tmp_path / "run" / "pitches.csv").read_text()
    assert pitches == "deployment,detector,pitch_from,pitch_to,tags,predicted,detected,corner_median,corner_90\n"


def test_a_number_is_short_for_a_crowd_and_each_frame_has_people_of_its_own():
    def scene_of(crowd):
        return build_problem(composed("evaluate", *LAB, f"visibility.crowd={crowd}")).scene

    short, long = scene_of("3").crowd, scene_of("{number: 3}").crowd
    assert short.crowd == long.crowd
    np.testing.assert_array_equal(short.people, long.people)
    assert scene_of("0").crowd is None
    scene = scene_of("{number: 5, states: 2}")
    poses = draw_poses(scene, 30, 0)
    drawn, people = draw_crowd(scene, poses[:, :3, 3], 0)
    assert len(drawn.crowd) == len(people) == 30
    assert 0 < 5 * 30 - sum(map(len, people)) < 30  # those around the camera are left out
