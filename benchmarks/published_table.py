"""A published table of errors by number of tags, predicted, and rendered, detected and solved by OpenCV.

python benchmarks/published_table.py [--frames 100] [--picture table.png]

ICAR 2025 (arXiv 2509.17345): errors in x with 1 to 7 ArUco tags of 15 cm at 2.99 m. Camera, arrangement of the tags,
which axis x is and what statistic the errors are could not be looked up, so several are tried.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from bundle import SQUARE

from lmd.core.checks import FloatArray
from lmd.detection.corner_errors import CORNER_ERRORS
from lmd.detection.detectors import ArucoDetector
from lmd.estimation.cramer_rao import pose_information
from lmd.formats.calibrations import Calibration
from lmd.geometry.camera import Camera
from lmd.geometry.projection import intrinsics, project
from lmd.geometry.se3 import camera_pose
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom
from lmd.scene.tag import Tag

PUBLISHED = (45.3, 24.9, 8.8, 5.1, 3.7, 3.2, 3.0)  # cm
EDGE, DISTANCE, MOST = 0.15, 2.99, 7
FAMILY, MODULES = "4x4_50", 6
CAMERAS = {"640 x 480, 60 degrees": (640, 480, 554.0), "1280 x 720, 70 degrees": (1280, 720, 914.0)}
ARRANGEMENTS = ("row, 0.25 m apart", "row, 0.5 m apart", "column, 0.25 m apart")
IMAGING = Imaging(psf_sigma=0.5, noise=2.0, texture=4.0)
BESIDE, TURNED = 0.3, 6.0  # offset of the camera to either side, metres; rotation from straight ahead, degrees
OFF = 0.002  # of each tag along each axis of the wall, in a map that was measured by hand, metres


def camera_of(name: str) -> Camera:
    """A pinhole camera."""
    width, height, focal = CAMERAS[name]
    return Calibration(width, height, (focal, focal), ((width - 1) / 2, (height - 1) / 2)).camera()


def centres(arrangement: str, count: int) -> FloatArray:
    """Of tags on the wall y = 0, from the middle outwards, `(count, 3)`."""
    kind, apart = arrangement.split(", ")
    steps = np.array([(-1) ** k * ((k + 1) // 2) for k in range(count)]) * float(apart.split()[0])
    zero = np.zeros(count)
    return np.stack([steps, zero, zero] if kind == "row" else [zero, zero, steps], axis=1)


def corners_of(places: FloatArray) -> FloatArray:
    """Top left, top right, bottom right, bottom left of tags that face -y, `(4 K, 3)`."""
    square = SQUARE[:, [0, 2, 1]] * EDGE
    return (places[:, None] + square).reshape(-1, 3)


def poses(count: int, rng: np.random.Generator) -> FloatArray:
    """Cameras in front of the wall, at the distance of the table, that look nearly straight ahead."""
    x, yaw = rng.uniform(-BESIDE, BESIDE, count), np.radians(rng.uniform(-TURNED, TURNED, count))
    return camera_pose(np.stack([x, np.full(count, -DISTANCE), np.zeros(count)], axis=1), yaw, np.zeros(count))


def predicted(camera: Camera, places: FloatArray, views: FloatArray, sigma: float) -> FloatArray:
    """Root mean square over the views of the standard deviations along the wall and from it, metres, `(2,)`."""
    points = corners_of(places)
    information = (
        pose_information([camera], np.eye(4)[None], views, points, np.ones((len(views), len(points)), dtype=bool)[None])
        / sigma**2
    )
    shares = np.linalg.inv(information)[:, 3:, 3:]
    world = views[:, :3, :3] @ shares @ np.swapaxes(views[:, :3, :3], 1, 2)
    return np.sqrt(np.array([world[:, 0, 0].mean(), world[:, 1, 1].mean()]))


def solved(camera: Camera, points: FloatArray, image: FloatArray) -> FloatArray:
    """Position of the camera by OpenCV's `solvePnPRansac`, `(3,)`."""
    matrix = intrinsics(camera)
    _, turn, way, _ = cv2.solvePnPRansac(points, image, matrix, None)
    return np.asarray(-cv2.Rodrigues(turn)[0].T @ way[:, 0])


def errors(camera: Camera, views: FloatArray, images: Iterator[dict[int, FloatArray]], maps: FloatArray) -> FloatArray:
    """Errors along and normal to the wall of frames in which all tags were found, metres, `(F, 2)`.

    Args:
        images: corners of the tags of each view, by number.
        maps: the centres of the tags that the solver assumes, for each view, `(V, K, 3)`.
    """
    found = []
    for view, corners, told in zip(views, images, maps, strict=True):
        if len(corners) == len(told):
            image = np.concatenate([corners[number] for number in range(len(told))])
            found.append((solved(camera, corners_of(told), image) - view[:3, 3])[:2])
    return np.array(found).reshape(-1, 2)


def rendered(camera: Camera, places: FloatArray, views: FloatArray) -> Iterator[dict[int, FloatArray]]:
    """What ArUco finds in rendered images."""
    count, detector = len(places), ArucoDetector(FAMILY)
    normals, ups = np.tile([0.0, -1.0, 0.0], (count, 1)), np.tile([0.0, 0.0, 1.0], (count, 1))
    renderer = Renderer(camera, TaggedRoom(Tag(EDGE, FAMILY), np.arange(count), places, normals, ups), IMAGING)
    for number, view in enumerate(views):
        found = detector.detect(renderer.frame(view, np.random.default_rng(number)))
        yield dict(zip(found.ids.tolist(), found.corners, strict=True))


def drawn(
    camera: Camera, places: FloatArray, views: FloatArray, sigma: float, rng: np.random.Generator
) -> Iterator[dict[int, FloatArray]]:
    """Corners with normal noise."""
    for view in views:
        image = project(camera, view, corners_of(places)).reshape(-1, 4, 2)
        yield dict(enumerate(image + rng.normal(0.0, sigma, image.shape)))


def rms(off: FloatArray) -> FloatArray:
    """Root mean square over the frames."""
    return np.asarray(np.sqrt((off**2).mean(axis=0)))


def centimetres(values: FloatArray) -> str:
    """Along the wall, and from it."""
    return " / ".join(f"{100 * value:.1f}" for value in values)


def main() -> None:
    """Print a table for each camera and arrangement."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--picture", type=Path, help="of the errors along the wall, tags in a row 0.25 m apart")
    chosen = parser.parse_args()
    frames, lines = chosen.frames, dict[str, list[float]]()
    print("Centimetres along the wall / from it, root mean square")
    for name in CAMERAS:
        camera, rng = camera_of(name), np.random.default_rng(0)
        pitch = camera.focal_pixels[0] * EDGE / MODULES / DISTANCE
        sigma = float(CORNER_ERRORS["aruco"].sigma(np.array(pitch)))
        views = poses(frames, rng)
        for arrangement in ARRANGEMENTS:
            print(f"\n{name}, {arrangement}; {pitch:.1f} pixels a module, corners off by {sigma:.2f} pixels\n")
            print("| tags | published | predicted | normal noise | rendered | worst | rendered, map off 2 mm |")
            print("| --- |" + " --- |" * 6)
            for count, said in enumerate(PUBLISHED, start=1):
                places = centres(arrangement, count)
                many, exact = np.repeat(views, 5, axis=0), np.broadcast_to(places, (frames, count, 3))
                # The wall is known to be flat.
                by_hand = exact + rng.normal(0.0, OFF, exact.shape) * [1.0, 0.0, 1.0]
                noisy = errors(camera, many, drawn(camera, places, many, sigma, rng), np.repeat(exact, 5, axis=0))
                seen = list(rendered(camera, places, views))
                off, measured = (errors(camera, views, iter(seen), told) for told in (exact, by_hand))
                cells = [predicted(camera, places, views, sigma), *map(rms, (noisy, off))]
                cells += [np.abs(off).max(axis=0), rms(measured)]
                if arrangement == ARRANGEMENTS[0]:
                    for kind, values in zip(("predicted", "normal noise", "rendered"), cells, strict=False):
                        lines.setdefault(f"{kind}, {name}", []).append(100 * float(values[0]))
                print(
                    f"| {count} ({len(off)} of {frames}) | {said} | {' | '.join(map(centimetres, cells))} |", flush=True
                )
    if chosen.picture is not None:
        draw(lines, chosen.picture)


def draw(lines: dict[str, list[float]], path: Path) -> None:
    """Errors by number of tags."""
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(6.0, 3.6))
    counts = range(1, MOST + 1)
    axis.plot(counts, PUBLISHED, "ko-", linewidth=2, label="published")
    styles = {"predicted": "-", "normal noise": ":", "rendered": "--"}
    colours = dict(zip(CAMERAS, ("tab:red", "tab:blue"), strict=True))
    for name, values in lines.items():
        kind, camera = name.split(", ", 1)
        axis.plot(counts, values, styles[kind], color=colours[camera], label=name)
    ticks = [0.2, 0.5, 1, 2, 5, 10, 20, 50, 100]
    axis.set(yscale="log", xlabel="tags in view", ylabel="error along the wall, cm")
    axis.set_yticks(ticks, [f"{tick:g}" for tick in ticks], minor=False)
    axis.minorticks_off()
    axis.legend(fontsize=7)
    figure.savefig(path, dpi=80, bbox_inches="tight")


if __name__ == "__main__":
    main()
