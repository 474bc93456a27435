"""`pipelines.survey` as a user meets it: a process, its messages, its exit code and the files it leaves."""

import json
import os
import re
import shutil

import cv2
import numpy as np
import pandas as pd
import pytest
from support import bags, processes, walks

from lmd.geometry.camera import Camera
from lmd.geometry.se3 import exp
from lmd.scene.deployment import Deployment
from lmd.scene.labels import Labels

CAMERA = Camera(2.2, 0.0075, 0.0075, (320.0, 240.0), 640, 480, 0.0)
EDGE, COUNT, FRAMES = 0.25, 16, 20
UNSEEN, NEW = 15, 40  # a tag that is planned only, and one that hangs only
BLURRED = "0020.png"  # a photograph that was taken while walking
ROOM = ["room=lab", "room.size=[5,4,2.5]", "room.reachable_size=[4,3,1.5]"]
SETTINGS = ["photographs=photos", "camera.path=camera.yaml", f"tag.edge={EDGE}", "tracking=none", "workers=1",
            "hydra.run.dir=out"]  # fmt: skip
READ = [setting for setting in SETTINGS if not setting.startswith(("photographs", "hydra"))]
FILES = {"map.csv", "measured.csv", "frames.csv", "detections.csv", "survey.json", "survey.png"}
FILES |= {"in_view.csv", "camera.yaml", "map.npz", "colmap", "transforms.json"}
pytestmark = pytest.mark.slow


def call(*overrides, cwd, settings=SETTINGS):
    return processes.inside("survey", *overrides, cwd=cwd, settings=settings)


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """Tags that hang off their plan, and photographs of them."""
    cwd, rng = tmp_path_factory.mktemp("work"), np.random.default_rng(4)
    plan = walks.spaced_tags(COUNT, rng)
    true = plan @ exp(rng.normal(size=(COUNT, 6)) * [0.0, 0.0, 0.01, 0.01, 0.01, 0.0])
    ids = np.where(np.arange(COUNT) == UNSEEN - 1, NEW, np.arange(COUNT))
    frames = walks.walk(FRAMES, rng)
    walks.calibration(cwd / "camera.yaml", CAMERA)
    walks.photograph(cwd / "photos", true[:UNSEEN], ids[:UNSEEN], frames, CAMERA, EDGE)
    sharp = cv2.imread(str(cwd / "photos" / "0003.png"), cv2.IMREAD_GRAYSCALE)
    cv2.imwrite(str(cwd / "photos" / BLURRED), cv2.blur(sharp, (7, 1)))
    planned = np.flatnonzero(np.arange(COUNT) != UNSEEN - 1)
    Deployment(plan[planned, :3, 3], plan[planned, :3, 2], labels=Labels(planned)).to_csv(cwd / "plan.csv", ups=True)
    return cwd, plan, true


@pytest.fixture(scope="module")
def surveyed(room):
    cwd, _, _ = room
    done = call("deployment.path=plan.csv", *ROOM, "export=[wpilib,apriltag_ros]", cwd=cwd)
    assert done.returncode == 0, done.stderr
    return cwd / "out", done.stdout


@pytest.mark.usefixtures("surveyed")
def test_a_bag_of_photographs_with_their_camera_is_surveyed_and_localised(room):
    """MCAP by another library; the map is that of the photographs."""
    cwd, _, _ = room
    rows = [("/camera_info", "sensor_msgs/msg/CameraInfo", 0, bags.camera_info(CAMERA))]
    for k, path in enumerate(sorted((cwd / "photos").iterdir())):
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        rows.append(("/image", "sensor_msgs/msg/Image", k * 10**9, bags.image(grey)))
    bags.write(cwd / "drive.mcap", rows)
    given = ["photographs=drive.mcap", f"tag.edge={EDGE}", "tracking=none", "workers=1"]
    done = call("deployment.path=plan.csv", *ROOM, "hydra.run.dir=bagged", cwd=cwd, settings=given)
    assert done.returncode == 0, done.stderr
    first, again = (pd.read_csv(cwd / folder / "map.csv").sort_values("id") for folder in ("out", "bagged"))
    np.testing.assert_allclose(again[["x", "y", "z"]], first[["x", "y", "z"]], atol=1e-6)
    more = ["map=bagged", "hydra.run.dir=localised"]
    done = processes.inside("localise", *more, cwd=cwd, settings=given)
    assert done.returncode == 0, done.stderr
    table = pd.read_csv(cwd / "localised" / "poses.csv")
    assert (table.state == "localised").sum() > 15
    processes.refused(
        "localise", *more, "topic=/rear", message="has no topic '/rear' of Image", cwd=cwd, settings=given
    )


def beside(table, true):
    """How far tags are from where they hang, metres, once the maps are laid on each other."""
    a, b = table[["x", "y", "z"]].to_numpy(), true[:, :3, 3]
    left, _, right = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
    turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return np.linalg.norm((a - a.mean(0)) @ turn - (b - b.mean(0)), axis=1)


def test_a_survey_leaves_its_files_and_nothing_else(surveyed):
    out, text = surveyed
    exported = {"tags.wpilib.json", "tags.apriltag_ros.yaml"}
    assert {path.name for path in out.iterdir()} == {*FILES, *exported, ".hydra"}
    assert cv2.imread(str(out / "survey.png")).shape == (700, 1500, 3)
    assert f"tags        {UNSEEN} of {COUNT} placed" in text
    assert f"not seen    {UNSEEN}\n" in text
    assert f"not planned {NEW}\n" in text
    assert f"blurred     {BLURRED} (" in text


def test_the_map_is_where_the_tags_hang(surveyed, room):
    _, _, true = room
    table = pd.read_csv(surveyed[0] / "map.csv").sort_values("id")
    assert table.id.tolist() == [*range(UNSEEN - 1), NEW]
    assert beside(table, true[:UNSEEN]).max() < 0.002
    assert (table.sigma < 0.002).all()
    np.testing.assert_allclose(table.edge, EDGE)


def test_measured_places_are_those_of_the_plan_where_a_tag_was_not_seen(surveyed, room):
    out, plan = surveyed[0], room[1]
    table = pd.read_csv(out / "measured.csv").set_index("id")
    assert table.index.tolist() == [*range(UNSEEN - 1), UNSEEN]
    np.testing.assert_allclose(table.loc[UNSEEN, ["x", "y", "z"]].astype(float), plan[UNSEEN, :3, 3])
    assert table.sightings[UNSEEN] == 0
    assert (np.linalg.norm(table[["x", "y", "z"]].to_numpy()[:-1] - plan[: UNSEEN - 1, :3, 3], axis=1) > 1e-3).any()


def test_the_document_says_what_became_of_each_tag(surveyed):
    document = json.loads((surveyed[0] / "survey.json").read_text())
    states = {row["id"]: row["state"] for row in document["tags"]}
    assert states == {**dict.fromkeys([*range(UNSEEN - 1), NEW], "placed"), UNSEEN: "not seen"}
    assert document["figures"]["moved/50"] > 0.003


def test_the_same_comes_from_the_detections_it_leaves(surveyed, room):
    cwd, out = room[0], surveyed[0]
    done = call(
        "deployment.path=plan.csv", "detections=out/detections.csv", "hydra.run.dir=again", cwd=cwd, settings=READ
    )
    assert done.returncode == 0, done.stderr
    first, again = (pd.read_csv(folder / "map.csv") for folder in (out, cwd / "again"))
    np.testing.assert_allclose(again.drop(columns="id"), first.drop(columns="id"), rtol=1e-6, atol=1e-9)


@pytest.mark.usefixtures("surveyed")
def test_a_detector_is_calibrated_on_the_frames_of_a_survey(room):
    cwd, _, _ = room
    done = processes.inside(
        "calibrate_detector", "survey=out", cwd=cwd, settings=["tracking=none", "hydra.run.dir=fit"]
    )
    assert done.returncode == 0, done.stderr
    assert re.search(r"^warning: survey: no limit can be fitted, as apriltag finds all of \d+ tags", done.stderr, re.M)
    text = (cwd / "fit" / "36h11_apriltag.yaml").read_text()
    assert "views of survey" in text
    assert "# Measured on " in text
    assert " photographs.\n" in text
    figures = json.loads((cwd / "fit" / "calibration.json").read_text())["figures"]["apriltag"]
    assert figures["views"] == len(pd.read_csv(cwd / "out" / "in_view.csv"))


@pytest.mark.usefixtures("surveyed")
def test_a_rig_has_a_folder_for_each_camera(room):
    """Two cameras that see the same, of which one begins later."""
    cwd, _, true = room
    for name, first in (("left", 0), ("right", 2)):
        folder = cwd / "rig" / name
        folder.mkdir(parents=True, exist_ok=True)
        for path in sorted((cwd / "photos").iterdir())[first:]:
            shutil.copy(path, folder)
    rig = "camera.rig=[{camera: camera.yaml}, {camera: camera.yaml}]"
    audit = ["audit=true", "visibility=fiducial", "visibility.detector=apriltag"]
    done = call("photographs=rig", rig, *audit, "hydra.run.dir=of_rig", cwd=cwd, settings=READ)
    assert done.returncode == 0, done.stderr
    foreseen = re.search(
        r"\naudit .* ([\d.]+)% of the predicted tags were detected, ([\d.]+)% of the detected", done.stdout
    )
    assert min(map(float, foreseen.groups())) > 90.0
    out = cwd / "of_rig"
    assert beside(pd.read_csv(out / "map.csv").sort_values("id"), true[:UNSEEN]).max() < 0.002
    cameras = json.loads((out / "survey.json").read_text())["cameras"]
    assert list(cameras) == ["left", "right"]
    np.testing.assert_allclose(cameras["right"], np.eye(4), atol=1e-3)
    seen = pd.read_csv(out / "detections.csv")
    assert set(seen.camera) == {"left", "right"}
    views = pd.read_csv(out / "in_view.csv")
    assert views.groupby("camera").seen.sum().tolist() == pytest.approx(seen.groupby("camera").size().tolist(), abs=3)


@pytest.mark.usefixtures("surveyed")
def test_images_without_a_tag_count_where_they_are_listed(room):
    """Without a list, the right camera is taken to have seen nothing in the images that it did not take."""
    cwd, _, _ = room
    seen = pd.read_csv(cwd / "out" / "detections.csv", dtype=str)
    left, right = (seen.assign(camera=name) for name in ("left", "right"))
    taken = sorted(seen.time.unique())[1::2]
    pd.concat([left, right[right.time.isin(taken)]]).to_csv(cwd / "both.csv", index=False)
    rows = [*(f"{time},left" for time in seen.time.unique()), *(f"{time},right" for time in taken)]
    (cwd / "images.csv").write_text("\n".join(["image,camera", *rows]))
    asked = ["detections=both.csv", "camera.rig=[{camera: camera.yaml}, {camera: camera.yaml}]"]
    views = []
    for name, images in (("all", []), ("listed", ["images=images.csv"])):
        done = call(*asked, *images, f"hydra.run.dir={name}", cwd=cwd, settings=READ)
        assert done.returncode == 0, done.stderr
        views.append(pd.read_csv(cwd / name / "in_view.csv"))
    assert set(views[1].time[views[1].camera == 2]) <= set(taken)
    left_out = views[0][(views[0].camera == 2) & ~views[0].time.isin(taken)]
    assert len(left_out) == len(views[0]) - len(views[1]) > 0
    assert not left_out.seen.any()


@pytest.mark.usefixtures("surveyed")
def test_without_a_plan_the_world_is_the_frame_of_a_tag(room):
    cwd, _, true = room
    done = call("detections=out/detections.csv", "survey.origin=3", "hydra.run.dir=alone", cwd=cwd, settings=READ)
    assert done.returncode == 0, done.stderr
    table = pd.read_csv(cwd / "alone" / "map.csv").set_index("id")
    np.testing.assert_allclose(table.loc[3, ["x", "y", "z", "nx", "ny", "nz"]], [0, 0, 0, 0, 0, 1], atol=1e-5)
    assert beside(table.sort_index(), true[:UNSEEN]).max() < 0.002
    assert not (cwd / "alone" / "measured.csv").exists()


@pytest.mark.usefixtures("surveyed")
def test_an_audit_names_the_tag_that_is_not_found_where_it_is_predicted(room):
    cwd, _, _ = room
    detections = pd.read_csv(cwd / "out" / "detections.csv", dtype=str)
    dirty = detections.id.value_counts().index[0]
    detections.drop(detections.index[detections.id == dirty][2:]).to_csv(cwd / "dirty.csv", index=False)
    audit = ["audit=true", "visibility=fiducial", "visibility.detector=apriltag", *ROOM]
    done = call("deployment.path=plan.csv", "detections=dirty.csv", *audit, "hydra.run.dir=audit", cwd=cwd,
                settings=READ)  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert f"\nstand out   {dirty} (in 2 of " in done.stdout
    tags = pd.read_csv(cwd / "audit" / "audit_tags.csv").set_index("id")
    assert tags.index[tags.stands_out].tolist() == [int(dirty)]
    assert (tags.confirmed <= tags[["predicted", "detected"]].min(axis=1)).all()
    assert tags.expected.sum() == pytest.approx(tags.confirmed.sum())
    for name, last in (("pitches", "pitch_to"), ("incidences", "incidence_to")):
        table = pd.read_csv(cwd / "audit" / f"audit_{name}.csv")
        assert (table[last].diff().dropna() > 0).all()
        assert table.tags.sum() >= tags.detected.sum()
    assert cv2.imread(str(cwd / "audit" / "audit.png")) is not None


@pytest.mark.usefixtures("surveyed")
def test_copies_of_photographs_count_once(room):
    """Also where their names are no UTF-8."""
    cwd = room[0]
    (cwd / "copied").mkdir()
    for number, path in enumerate(sorted((cwd / "photos").iterdir())):
        shutil.copy(path, cwd / "copied")
        for suffix in (b"\xe9", b"x") if number < 4 else ():
            shutil.copy(path, os.fsencode(cwd / "copied" / path.stem) + suffix + b".png")
    done = call("photographs=copied", "deployment.path=plan.csv", "hydra.run.dir=once", cwd=cwd)
    assert done.returncode == 0, done.stderr
    assert re.search(
        r"^copies +\d+ images, not counted: such as 0000\\udce9.png of 0000.png$", done.stdout, re.MULTILINE
    )
    first, again = (pd.read_csv(cwd / folder / "map.csv") for folder in ("out", "once"))
    np.testing.assert_allclose(again.drop(columns="id"), first.drop(columns="id"), rtol=1e-6, atol=1e-9)
    copies = json.loads((cwd / "once" / "survey.json").read_text())["copies"]
    assert copies["0000\\udce9.png"] == "0000.png"
