"""What a survey is worth where the truth is known; each prints or leaves what its name says.

python benchmarks/survey.py photograph RUN FOLDER [--count 80]   # photographs of a run's tags, hung 10 mm off; true.csv
python benchmarks/survey.py compare MAP.csv TRUE.csv             # how far the tags of a map are off, millimetres
python benchmarks/survey.py aviary test_13 [--boards 0.0002] [--calibrate false]  # of berndpfrommer/tagslam_test
python benchmarks/survey.py perch test_2 [--calibrate false]  # two fisheye cameras, beside TagSLAM's own answer
python benchmarks/survey.py halves FOLDER EDGE [--every null]   # maps of the two halves of a drive, side by side
python benchmarks/survey.py rings SURVEY U V   # share of tags in view that were detected, by pixels from (U, V)
PYTHONPATH=tests python benchmarks/survey.py time FRAMES TAGS [--cameras 4]   # how long a walk takes, and its memory
"""

import argparse
import json
import resource
import time
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from omegaconf import OmegaConf

from lmd.geometry.se3 import camera_pose, exp
from lmd.pipelines.building import camera_of
from lmd.pipelines.nodes import instantiate
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom
from lmd.scene.deployment import Deployment, poses_of
from lmd.scene.labels import Surveyed

if TYPE_CHECKING:
    from lmd.geometry.camera import Camera
    from lmd.survey.survey import Survey

OFF = (
    0.002,
    0.002,
    0.0087,
    0.010,
    0.010,
    0.0,
)  # standard deviations of how tags hang: tilts, turn, rad; places, metres
EYE_LEVEL = (1.0, 1.7)  # metres
IMAGING = Imaging(psf_sigma=0.5, noise=2.0, texture=4.0)


def photograph(run: Path, folder: Path, count: int, seed: int) -> None:
    """Render a walk: random places where the camera may be, at eye level, looking about."""
    cfg, rng = OmegaConf.load(run / ".hydra" / "config.yaml"), np.random.default_rng(seed)
    room, camera, tag = instantiate(cfg.room), camera_of(cfg.camera), instantiate(cfg.tag)
    plan = Deployment.from_csv(run / "landmarks.csv")
    hung = poses_of(plan) @ exp(rng.normal(size=(len(plan), 6)) * OFF)
    places, normals, ups = hung[:, :3, 3], hung[:, :3, 2], hung[:, :3, 1]
    where = room.sample(count, rng)
    where[:, 2] = rng.uniform(*EYE_LEVEL, count)
    yaw, pitch, roll = rng.uniform(-np.pi, np.pi, count), rng.normal(0.0, 0.15, count), rng.normal(0.0, 0.1, count)
    renderer = Renderer(camera, TaggedRoom(tag, plan.ids, places, normals, ups, room.faces()), IMAGING)
    folder.mkdir(parents=True, exist_ok=True)
    for number, pose in enumerate(camera_pose(where, yaw, pitch, roll)):
        cv2.imwrite(str(folder / f"{number:04d}.png"), renderer.frame(pose, np.random.default_rng([seed, number])))
    true = Deployment(places, normals, labels=plan.labels, surveyed=Surveyed(places, places, ups))
    true.to_csv(folder / "true.csv", ups=True)


def compare(found: Path, true: Path) -> None:
    """Median, 90 % and largest distance, once the maps are laid on each other and as they are."""
    one, other = Deployment.from_csv(found), Deployment.from_csv(true)
    _, of, among = np.intersect1d(one.ids, other.ids, return_indices=True)
    here, there = one.places[of], other.places[among]
    a, b = here - here.mean(axis=0), there - there.mean(axis=0)
    left, _, right = np.linalg.svd(a.T @ b)
    turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    for name, away in (("beside each other", a @ turn - b), ("in the world", here - there)):
        figures = 1e3 * np.quantile(np.linalg.norm(away, axis=1), [0.5, 0.9, 1.0])
        print(f"{len(of)} tags {name}: median {figures[0]:.2f}, 90 % {figures[1]:.2f}, largest {figures[2]:.2f} mm")


def aviary(folder: Path, boards: float | None, calibrate: bool | None) -> None:
    """Spacing of the tags on boards of 2 x 3, and the map beside TagSLAM's."""
    from lmd.detection.corner_errors import CORNER_ERRORS
    from lmd.formats.calibrations import calibrated_camera
    from lmd.formats.detection_formats import read_detections
    from lmd.scene.tag import Tag
    from lmd.survey.knowledge import Boards, PriorKnowledge
    from lmd.survey.results import to_text
    from lmd.survey.survey import survey

    ids = np.arange(6, 114)
    row, column = np.divmod((ids - 6) % 6, 3)
    places = 0.15 * np.stack([column, row], axis=1)
    told = Boards(tuple(map(str, (ids - 6) // 6)), ids, places, boards) if boards else None
    camera, detected = calibrated_camera(str(folder / "cameras.yaml")), read_detections(folder / "detections.csv")
    began = time.process_time()
    found = survey(detected, [camera], Tag(0.12), CORNER_ERRORS["apriltag"], PriorKnowledge(boards=told), calibrate)
    print(f"{to_text(found)}\n{time.process_time() - began:.0f} s")
    hung = np.full((114, 3), np.nan)
    hung[found.ids[found.placed]] = found.found.poses.tags[found.placed, :3, 3]
    away = [np.linalg.norm(hung[k] - hung[k + step], axis=-1) for step, k in ((1, ids[column < 2]), (3, ids[row < 1]))]
    off = 1e3 * (np.concatenate(away) - 0.15)
    figures = np.nanquantile(np.abs(off), [0.5, 0.9])
    print(f"spacing off: median {figures[0]:.2f}, 90 % {figures[1]:.2f}, mean with its sign {np.nanmean(off):.2f} mm")
    by_opencv(found, found.found.calibrated[0].found)


def by_opencv(found: "Survey", camera: "Camera") -> None:
    """Each frame by OpenCV's solvePnP with the map: how far from the survey's, and what corners are off by."""
    from lmd.geometry.projection import intrinsics

    some, poses, matrix = found.found.sightings.of(found.found.used), found.found.poses, intrinsics(camera)
    corners = some.corners @ np.swapaxes(poses.tags[some.tag, :3, :3], 1, 2) + poses.tags[some.tag, None, :3, 3]
    lens = np.array(camera.distortion)
    away, errors = [], []
    for frame in np.unique(some.frame):
        own = some.frame == frame
        points, image = corners[own].reshape(-1, 3), some.image[own].reshape(-1, 2)
        _, turn, way = cv2.solvePnP(points, image, matrix, lens, flags=cv2.SOLVEPNP_SQPNP)
        turn, way = cv2.solvePnPRefineLM(points, image, matrix, lens, turn, way)
        place = -cv2.Rodrigues(turn)[0].T @ way[:, 0]
        away.append(1e3 * np.linalg.norm(place - poses.frames[frame, :3, 3]))
        seen = cv2.projectPoints(points, turn, way, matrix, lens)[0][:, 0]
        errors.append(np.linalg.norm(seen - image, axis=1))
    off = np.concatenate(errors)
    text = f"median {np.median(away):.2f}, 90 % {np.quantile(away, 0.9):.2f} mm from the survey's places"
    print(f"cv2.solvePnP, {len(away)} frames: {text}; corners {np.median(off):.3f} pixels off")


def perch(folder: Path, calibrate: bool | None) -> None:
    """Tags and the mount of the second camera beside TagSLAM's."""
    from scipy.spatial.transform import Rotation

    from lmd.core.tables import read_table
    from lmd.detection.corner_errors import CORNER_ERRORS
    from lmd.formats.calibrations import calibrated_camera
    from lmd.formats.detection_formats import read_detections
    from lmd.geometry.se3 import act, rigid_alignment
    from lmd.scene.tag import Tag
    from lmd.survey.knowledge import PriorKnowledge
    from lmd.survey.results import to_text
    from lmd.survey.survey import survey

    cameras = [calibrated_camera(str(folder / "cameras.yaml"), name) for name in ("cam0", "cam1")]
    began = time.process_time()
    found = survey(
        read_detections(folder / "detections.csv"),
        cameras,
        Tag(0.16),
        CORNER_ERRORS["apriltag"],
        PriorKnowledge(),
        calibrate,
    )
    print(f"{to_text(found)}\n{time.process_time() - began:.0f} s")
    table = read_table(folder / "reference_tf_last.csv", name="reference")
    rows = {child: row for row, child in enumerate(table.texts["child"])}
    told = {int(child.rpartition("_")[2]): row for child, row in rows.items() if "tag_" in child}

    def place(row: int) -> list[float]:
        return [float(table.texts[axis][row]) for axis in "xyz"]

    both = [k for k in np.flatnonzero(found.placed) if int(found.ids[k]) in told]
    theirs = np.array([place(told[int(found.ids[k])]) for k in both])
    own = found.found.poses.tags[both, :3, 3]
    off = 1e3 * np.linalg.norm(act(rigid_alignment(own, theirs), own) - theirs, axis=1)
    print(f"{len(both)} tags off TagSLAM's: median {np.median(off):.2f}, largest {off.max():.2f} mm")
    if (row := rows.get("cam1")) is not None:
        turn = Rotation.from_quat([float(table.texts[f"q{axis}"][row]) for axis in "xyzw"])
        mount = found.found.poses.mounts[1]
        angle = (turn.inv() * Rotation.from_matrix(mount[:3, :3])).magnitude()
        print(f"the second camera {1e3 * np.linalg.norm(mount[:3, 3] - place(row)):.2f} mm, {1e3 * angle:.2f} mrad off")


def halves(folder: Path, edge: float, every: int | None) -> None:
    """Map each half of a drive alone: how far tags are apart once the maps are laid over each other, and as stated.

    The folder has `detections.csv`, and `cameras.yaml` with the cameras in the order of their names.
    """
    from lmd.detection.corner_errors import CORNER_ERRORS
    from lmd.formats.calibrations import calibrated_camera, read_cameras
    from lmd.formats.detection_formats import read_detections
    from lmd.geometry.se3 import act, rigid_alignment
    from lmd.scene.tag import Tag
    from lmd.survey.keyframes import select_keyframes
    from lmd.survey.knowledge import PriorKnowledge
    from lmd.survey.survey import survey

    detected, path = read_detections(folder / "detections.csv"), str(folder / "cameras.yaml")
    cameras = [calibrated_camera(path, name or None) for name in list(read_cameras(path))[: len(detected.cameras)]]
    first = detected.frame < len(detected.times) // 2
    print(
        "| survey.calibrate | tags in both | halves differ, median, 90 %, mm | stated for that difference, median, mm ",
        end="",
    )
    print("| within 3 sigma | sightings count less by | scale differs | frames left out | time, s |\n|" + " --- |" * 9)
    for calibrate in (None, True, False):
        maps, began, left_out = [], time.process_time(), 0
        for half in (first, ~first):
            some = select_keyframes(detected.of(np.flatnonzero(half)), every)
            left_out += len(some.left_out)
            maps.append(survey(some, cameras, Tag(edge), CORNER_ERRORS["apriltag"], PriorKnowledge(), calibrate))
        _, *index = np.intersect1d(*(one.ids[one.placed] for one in maps), return_indices=True)
        own = [np.flatnonzero(one.placed)[k] for one, k in zip(maps, index, strict=True)]
        here, there = (one.found.poses.tags[k, :3, 3] for one, k in zip(maps, own, strict=True))
        apart = np.linalg.norm(act(rigid_alignment(here, there), here) - there, axis=1)
        stated = np.hypot(*(one.found.sigmas[k] for one, k in zip(maps, own, strict=True)))
        within, told = float((apart <= 3.0 * stated).mean()), 1e3 * np.median(stated)
        low, high = 1e3 * np.quantile(apart, [0.5, 0.9])
        scale = np.std(there, axis=0) @ np.std(there, axis=0) / (np.std(here, axis=0) @ np.std(here, axis=0))
        factors = ", ".join(f"{one.found.inflation:.1f}" for one in maps)
        words = {None: "auto", True: "true", False: "false"}[calibrate]
        print(f"| {words} | {len(apart)} | {low:.2f}, {high:.2f} | {told:.2f} | {within:.0%} ", end="")
        seconds = time.process_time() - began
        print(
            f"| {factors} | {np.sqrt(scale) - 1.0:+.2%} | {left_out} of {len(detected.times)} | {seconds:.0f} |",
            flush=True,
        )


def measure(frames: int, tags: int, cameras: int) -> None:
    """Time of one processor and memory, from detections to figures."""
    from support import walks  # of the tests

    from lmd.scene.tag import Tag
    from lmd.survey.knowledge import PriorKnowledge
    from lmd.survey.survey import survey

    rng, mounts = np.random.default_rng(0), np.tile(np.eye(4), (cameras, 1, 1))
    for k, mount in enumerate(mounts):  # in a ring, each looks its own way
        mount[:3, :3] = cv2.Rodrigues(np.array([0.0, 2.0 * np.pi * k / cameras, 0.0]))[0]
        mount[:3, 3] = 0.1 * (mount[:3, 2] - [0.0, 0.0, 1.0])
    hung = walks.hung(walks.wall_tags(tags, rng), rng)
    detected = walks.photographed(hung, walks.walk(frames, rng), rng, mounts=mounts)
    began = time.process_time()
    found = survey(detected, [walks.CAMERA] * cameras, Tag(walks.EDGE), walks.constant_errors(0.2), PriorKnowledge())
    seconds, most = time.process_time() - began, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"{frames} frames of {cameras} cameras, {found.placed.sum()} of {tags} tags: {seconds:.0f} s, {most:.2f} GiB")


def rings(survey: Path, u: float, v: float) -> None:
    """Print the detected fraction of the tags wholly in an image, by distance from (u, v), pixels."""
    import pandas as pd

    views = pd.read_csv(survey / "in_view.csv")
    away = pd.cut(np.hypot(views.u - u, views.v - v), [*range(0, 701, 100), np.inf], right=False)
    print(views.groupby(away, observed=True).seen.agg(["mean", "size"]).round(2).to_string())


def main() -> None:
    """Run the command that the first argument names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    walk = commands.add_parser("photograph")
    walk.add_argument("run", type=Path)
    walk.add_argument("folder", type=Path)
    walk.add_argument("--count", type=int, default=80)
    walk.add_argument("--seed", type=int, default=0)
    two = commands.add_parser("compare")
    two.add_argument("found", type=Path)
    two.add_argument("true", type=Path)
    real = commands.add_parser("aviary")
    real.add_argument("folder", type=Path)
    real.add_argument("--boards", type=float, help="how exact they were printed, metres")
    real.add_argument("--calibrate", type=json.loads, help="true or false; else what is the default")
    two_cameras = commands.add_parser("perch")
    two_cameras.add_argument("folder", type=Path)
    two_cameras.add_argument("--calibrate", type=json.loads, help="true or false; else what is the default")
    round_image = commands.add_parser("rings")
    round_image.add_argument("survey", type=Path)
    round_image.add_argument("u", type=float)
    round_image.add_argument("v", type=float)
    two_halves = commands.add_parser("halves")
    two_halves.add_argument("folder", type=Path)
    two_halves.add_argument("edge", type=float, help="of the tags, metres")
    two_halves.add_argument("--every", type=json.loads, default=1, help="n-th frame; null for those that add to others")
    timed = commands.add_parser("time")
    timed.add_argument("frames", type=int)
    timed.add_argument("tags", type=int)
    timed.add_argument("--cameras", type=int, default=1)
    given = parser.parse_args()
    if given.command == "photograph":
        photograph(given.run, given.folder, given.count, given.seed)
    elif given.command == "compare":
        compare(given.found, given.true)
    elif given.command == "aviary":
        aviary(given.folder, given.boards, given.calibrate)
    elif given.command == "perch":
        perch(given.folder, given.calibrate)
    elif given.command == "halves":
        halves(given.folder, given.edge, given.every)
    elif given.command == "rings":
        rings(given.survey, given.u, given.v)
    else:
        measure(given.frames, given.tags, given.cameras)


if __name__ == "__main__":
    main()
