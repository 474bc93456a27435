"""All real data in one table: what `lmd` says, and what a plain bundle adjustment makes of the same detections.

python benchmarks/real.py FOLDER [--only test_13 test_2 photographs_flat photographs] [--halves]
python benchmarks/real.py FOLDER --only photographs_flat --maps NAME=map.csv   # and others: id,x,y,z,qx,qy,qz,qw

FOLDER has `detections/test_13`, `detections/test_2`, `photographs_flat` and `photographs`. Millimetres; a figure for
many tags is median / 90 % / largest. Maps are compared after a rigid motion; after a similarity. `--halves` maps the
two halves of a drive alone, which takes twice as long.
"""

import argparse
import csv
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import yaml
from bundle import SQUARE, Bundle, Lens, adjust
from scipy.spatial.transform import Rotation

from lmd.core.checks import FloatArray
from lmd.detection.corner_errors import CORNER_ERRORS
from lmd.detection.detectors import AprilTagDetector, ArucoDetector
from lmd.formats.calibrations import Calibration, calibrated_camera
from lmd.formats.detection_formats import read_detections
from lmd.formats.detections import DetectedTags
from lmd.geometry.camera import PIXEL_CENTRE, Camera
from lmd.geometry.pose import solutions
from lmd.scene.tag import Tag
from lmd.survey.knowledge import PriorKnowledge
from lmd.survey.survey import survey

ANGLES = (-60, -30, 30, 60)  # degrees, of the photographs of one tag that was turned


class Map(NamedTuple):
    """Poses of tags in any frame, by their numbers, and the standard deviations that are stated, metres."""

    tags: dict[int, FloatArray]
    stated: dict[int, float]
    note: str


class Recording(NamedTuple):
    """Detections, and what they were seen by."""

    detected: DetectedTags
    cameras: list[Camera]
    lenses: list[Lens]
    edge: float
    family: str
    detector: str


def by_lmd(recording: Recording, calibrate: bool | None = None) -> Map:
    """The survey's map."""
    found = survey(
        recording.detected,
        recording.cameras,
        Tag(recording.edge, recording.family),
        CORNER_ERRORS[recording.detector],
        PriorKnowledge(),
        calibrate,
    )
    placed, sigma = np.flatnonzero(found.placed), found.found.sigmas
    stated = {int(found.ids[k]): float(sigma[k]) for k in placed}
    note = f"{len(found.found.sightings)} sightings"
    return Map({int(found.ids[k]): found.found.poses.tags[k] for k in placed}, stated, note)


def by_bundle(recording: Recording, free: bool) -> Map:
    """That of the plain bundle adjustment."""
    seen = recording.detected
    corners = seen.corners - PIXEL_CENTRE
    found: Bundle = adjust(seen.frame, seen.camera, seen.ids, corners, recording.lenses, recording.edge, free)
    tags = {int(number): tag for number, tag in zip(found.ids, found.tags, strict=True) if np.isfinite(tag).all()}
    note = f"{found.used} sightings, rms {found.rms:.2f} pixels"
    if free:
        moved = [one.numbers[2:4] - lens.numbers[2:4] for one, lens in zip(found.lenses, recording.lenses, strict=True)]
        note += f", centre moved by {' and '.join(f'{u:+.2f}, {v:+.2f}' for u, v in moved)}"
    return Map(tags, {}, note)


METHODS: dict[str, Callable[[Recording], Map]] = {
    "lmd": by_lmd,
    "lmd, calibrate": lambda recording: by_lmd(recording, True),
    "lmd, as given": lambda recording: by_lmd(recording, False),
    "bundle adjustment": lambda recording: by_bundle(recording, False),
    "bundle adjustment, intrinsics free": lambda recording: by_bundle(recording, True),
}


def rigid_alignment(here: FloatArray, there: FloatArray, scaled: bool = False) -> tuple[FloatArray, float]:
    """Points `(K, 3)` moved onto others by the best rigid motion, or similarity; and its scale."""
    a, b = here - here.mean(axis=0), there - there.mean(axis=0)
    left, values, right = np.linalg.svd(a.T @ b)
    signs = np.array([1.0, 1.0, np.linalg.det(left @ right)])
    scale = (values * signs).sum() / (a**2).sum() if scaled else 1.0
    return np.asarray(scale * a @ (left * signs) @ right + there.mean(axis=0)), float(scale)


def apart(one: Map, other: Map, scaled: bool = False) -> tuple[FloatArray, float]:
    """Distances of the tags in both once one map is laid over the other, metres, and the scale that this took."""
    both = sorted(one.tags.keys() & other.tags.keys())
    here, there = (np.array([own.tags[number][:3, 3] for number in both]) for own in (one, other))
    moved, scale = rigid_alignment(here, there, scaled)
    return np.asarray(np.linalg.norm(moved - there, axis=1)), scale


def beside(one: Map, other: Map) -> str:
    """The distances after a rigid motion, and those after a similarity with its scale."""
    off, scale = apart(one, other, True)
    return f"{millimetres(apart(one, other)[0])}; {millimetres(off)} (scale {100 * (scale - 1):+.2f} %)"


def millimetres(off: FloatArray) -> str:
    """Median, 90 % and largest."""
    return " / ".join(f"{1e3 * value:.2f}" for value in np.quantile(off, [0.5, 0.9, 1.0]))


def of_halves(recording: Recording, method: Callable[[Recording], Map]) -> str:
    """How far the maps of the two halves are apart, and what was stated for that difference."""
    seen = recording.detected
    first = seen.frame < len(seen.times) // 2
    maps = [method(recording._replace(detected=seen.of(np.flatnonzero(half)))) for half in (first, ~first)]
    off, both = apart(*maps)[0], sorted(maps[0].tags.keys() & maps[1].tags.keys())
    if not maps[0].stated:
        return f"{1e3 * np.median(off):.2f}"
    told = np.hypot(*(np.array([one.stated[number] for number in both]) for one in maps))
    return (
        f"{1e3 * np.median(off):.2f} (stated {1e3 * np.median(told):.2f}; {(off <= 3.0 * told).mean():.0%} in 3 sigma)"
    )


def drive(folder: Path, edge: float) -> Recording:
    """A recording with the calibration of its cameras in Kalibr's form."""
    path = folder / "cameras.yaml"
    keys = yaml.safe_load(path.read_text())
    names = sorted(keys)
    lenses = [
        Lens(
            np.array([*keys[name]["intrinsics"], *keys[name]["distortion_coeffs"]]),
            keys[name]["distortion_model"] == "equidistant",
        )
        for name in names
    ]
    cameras = [calibrated_camera(str(path), name) for name in names]
    return Recording(read_detections(folder / "detections.csv"), cameras, lenses, edge, "36h11", "apriltag")


def tagslam(folder: Path) -> Map:
    """TagSLAM's own answer: tags on boards, and those in the world."""
    poses: dict[str, tuple[str, FloatArray]] = {}
    with (folder / "reference_tf_last.csv").open() as file:
        for row in csv.DictReader(file):
            pose = np.eye(4)
            pose[:3, :3] = Rotation.from_quat([float(row[f"q{axis}"]) for axis in "xyzw"]).as_matrix()
            pose[:3, 3] = [float(row[axis]) for axis in "xyz"]
            poses[row["child"]] = (row["parent"], pose)
    tags = {}
    for name in poses:
        if name.startswith("tag_"):
            pose, at = np.eye(4), name
            while at in poses:
                at, own = poses[at]
                pose = own @ pose
            tags[int(name.removeprefix("tag_"))] = pose
    return Map(tags, {}, "its own sightings")


def spacing(found: Map) -> str:
    """Distances of neighbours on the boards of 2 x 3 off 0.15 m, and their mean with its sign."""
    off = []
    for number, tag in found.tags.items():
        row, column = divmod((number - 6) % 6, 3)
        for other, exists in ((number + 1, column < 2), (number + 3, row < 1)):
            if exists and other in found.tags:
                off.append(np.linalg.norm(tag[:3, 3] - found.tags[other][:3, 3]) - 0.15)
    return f"{millimetres(np.abs(off))} (mean {1e3 * np.mean(off):+.2f})"


def on_plane(found: Map, edge: float) -> FloatArray:
    """Corners of all tags along the axes of their common plane and off it, `(K, 4, 3)`, metres."""
    corners = np.array([SQUARE * edge @ tag[:3, :3].T + tag[:3, 3] for tag in found.tags.values()])
    off = corners - corners.mean(axis=(0, 1))
    axes = np.linalg.svd(off.reshape(-1, 3), full_matrices=False)[2]
    # One side up, so that maps can be compared by eye.
    signs = [np.sign(axis[np.abs(axis).argmax()]) for axis in axes]
    return np.asarray(off @ (axes * np.array(signs)[:, None]).T)


def flatness(found: Map, edge: float) -> str:
    """Corners off their common plane, root mean square."""
    return f"{1e3 * np.sqrt((on_plane(found, edge)[..., 2] ** 2).mean()):.2f}"


def draw(maps: dict[str, Map], edge: float, path: Path) -> None:
    """Tags of each map from above, coloured by how high they are, millimetres."""
    import matplotlib.pyplot as plt
    from matplotlib.collections import PolyCollection

    figure, axes = plt.subplots(1, len(maps), figsize=(3.0 * len(maps), 3.4), sharex=True, sharey=True)
    for axis, (name, found) in zip(axes, maps.items(), strict=True):
        corners = 1e3 * on_plane(found, edge)
        tags = PolyCollection(corners[..., :2], cmap="RdBu", clim=(-5.0, 5.0), edgecolor="black", linewidth=0.5)
        tags.set_array(corners[..., 2].mean(axis=1))
        axis.add_collection(tags)
        axis.autoscale()
        axis.set(title="\n".join([*name.split(", "), f"{flatness(found, edge)} mm rms"]), aspect="equal", xlabel="mm")
    figure.colorbar(tags, ax=axes, label="off the plane, mm", shrink=0.8)
    figure.savefig(path, dpi=80, bbox_inches="tight")


def compared(
    recording: Recording, others: dict[str, Map], figures: dict[str, Callable[[Map], str]], halves: bool
) -> dict[str, Map]:
    """A row for each method and map of others; returns the maps of the methods."""
    made = {}
    heads = [*figures, *(["halves differ"] if halves else []), "known to", "time"]
    print("| map by | tags | " + " | ".join(heads) + " |\n| --- | --- |" + " --- |" * len(heads))
    for name, method in METHODS.items():
        began = time.process_time()
        made[name] = found = method(recording)
        took = f"{time.process_time() - began:.0f} s"
        cells = [figure(found) for figure in figures.values()] + ([of_halves(recording, method)] if halves else [])
        told = f"{1e3 * np.median(list(found.stated.values())):.2f}" if found.stated else ""
        print(f"| {name}, {found.note} | {len(found.tags)} | {' | '.join([*cells, told, took])} |", flush=True)
    for name, found in others.items():
        cells = [figure(found) for figure in figures.values()] + ([""] if halves else [])
        print(f"| {name} | {len(found.tags)} | {' | '.join([*cells, '', ''])} |", flush=True)
    return made


def test_13(folder: Path, halves: bool) -> None:
    """A hand-held camera, 96 tags on 16 boards."""
    own = folder / "detections" / "test_13"
    recording, told = drive(own, 0.12), tagslam(own)
    figures = {"neighbours off 0.15 m": spacing, "tags off TagSLAM's": lambda found: beside(found, told)}
    compared(recording, {"TagSLAM, which was told of the boards": told}, figures, halves)


def test_2(folder: Path, halves: bool) -> None:
    """Two fisheye cameras, 13 tags."""
    own = folder / "detections" / "test_2"
    told = tagslam(own)
    figures = {"tags off TagSLAM's": lambda found: beside(found, told)}
    compared(drive(own, 0.16), {"TagSLAM": told}, figures, halves)


def flat(folder: Path, maps: dict[str, Path], picture: Path | None) -> None:
    """Eleven tags on one surface in fifteen photographs."""
    own = folder / "photographs_flat"
    info = yaml.safe_load((own / "camera_info.yaml").read_text())
    matrix = info["camera_matrix"]["data"]
    lens = Lens(np.array([matrix[0], matrix[4], matrix[2], matrix[5], 0.0, 0.0, 0.0, 0.0]), False)
    others = {name: csv_map(path) for name, path in maps.items()}
    for corners in ("author", "opencv_aruco_original"):
        detected = read_detections(own / f"detections_{corners}.csv")
        camera = calibrated_camera(str(own / "camera_info.yaml"))
        # ARUCO_ORIGINAL has 7 modules, as the family 5x5_1000.
        recording = Recording(detected, [camera], [lens], 0.030, "5x5_1000", "aruco")
        plain = by_bundle(recording, False)
        figures: dict[str, Callable[[Map], str]] = {
            "off their plane, rms": lambda found: flatness(found, 0.030),
            "tags off the bundle adjustment's": lambda found, plain=plain: millimetres(apart(found, plain, True)[0]),
        }
        print(f"\nCorners of detections_{corners}.csv")
        made = compared(recording, others, figures, False)
    if picture is not None:
        draw(made, 0.030, picture)


def csv_map(path: Path) -> Map:
    """A map of others: `id,x,y,z,qx,qy,qz,qw`, tag to world."""
    tags = {}
    with path.open() as file:
        for row in csv.DictReader(file):
            pose = np.eye(4)
            pose[:3, :3] = Rotation.from_quat([float(row[name]) for name in ("qx", "qy", "qz", "qw")]).as_matrix()
            pose[:3, 3] = [float(row[axis]) for axis in "xyz"]
            tags[int(row["id"])] = pose
    return Map(tags, {}, "")


def turned(folder: Path) -> None:
    """One tag of 0.065 m, photographed at known turns: how far it turned since the photograph at zero."""
    own = folder / "photographs"
    info = yaml.safe_load((own / "test_info.yaml").read_text())["rotation_test"]
    f_x, _, c_x, _, f_y, c_y, *_ = info["K"]
    camera = Calibration(info["width"], info["height"], (f_x, f_y), (c_x, c_y)).camera()
    points = SQUARE * info["tag_size"] * np.array([1.0, 1.0, 1.0])
    matrix = np.array([[f_x, 0.0, c_x], [0.0, f_y, c_y], [0.0, 0.0, 1.0]])
    print("| detector, pose by | " + " | ".join(f"{angle:+d}" for angle in ANGLES) + " | distances, m |")
    print("| --- |" + " --- |" * (len(ANGLES) + 1))
    for name, detector in (("apriltag", AprilTagDetector()), ("aruco", ArucoDetector())):
        corners = {}
        for angle in (0, *ANGLES):
            image = cv2.imread(str(own / f"test_image_rotation_{angle}.png"), cv2.IMREAD_GRAYSCALE)
            corners[angle] = detector.detect(image).corners[0]
        by = {
            "lmd": {at: np.linalg.inv(solutions(camera, points, seen)[0].pose) for at, seen in corners.items()},
            "solvePnP": {at: _ippe(points, seen - PIXEL_CENTRE, matrix) for at, seen in corners.items()},
        }
        for method, poses in by.items():
            turns = {at: Rotation.from_matrix(poses[0][:3, :3].T @ pose[:3, :3]) for at, pose in poses.items()}
            cells = [f"{np.degrees(turns[angle].magnitude()):.2f}" for angle in ANGLES]
            distances = [float(np.linalg.norm(pose[:3, 3])) for pose in poses.values()]
            print(f"| {name}, {method} | {' | '.join(cells)} | {min(distances):.4f} to {max(distances):.4f} |")


def _ippe(points: FloatArray, corners: FloatArray, matrix: FloatArray) -> FloatArray:
    _, turn, way = cv2.solvePnP(points, corners, matrix, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], way[:, 0]
    return pose


def main() -> None:
    """See above."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="+", default=["test_13", "test_2", "photographs_flat", "photographs"])
    parser.add_argument("--halves", action="store_true")
    parser.add_argument("--maps", nargs="*", default=[], help="NAME=map.csv, of the flat photographs")
    parser.add_argument("--picture", type=Path, help="of the flat photographs' tags, off their plane")
    chosen = parser.parse_args()
    maps = {name: Path(path) for name, _, path in (text.partition("=") for text in chosen.maps)}
    run: dict[str, Callable[[], None]] = {
        "test_13": lambda: test_13(chosen.folder, chosen.halves),
        "test_2": lambda: test_2(chosen.folder, chosen.halves),
        "photographs_flat": lambda: flat(chosen.folder, maps, chosen.picture),
        "photographs": lambda: turned(chosen.folder),
    }
    for name in chosen.only:
        print(f"\n## {name}\n", flush=True)
        run[name]()


if __name__ == "__main__":
    main()
