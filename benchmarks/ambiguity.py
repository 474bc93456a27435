"""How often one tag is taken for its mirrored pose: `python benchmarks/ambiguity.py`; `... RUN RUN` for deployments.

Prints Markdown tables for a tag of 15 cm and the camera of `experiment=lab`:

1. the closed form of `lmd.objectives.localisation.ambiguity` against the residual of IPPE's other pose, noise-free;
2. the share of wrong poses by distance and incidence: predicted, simulated (noise on projected corners, OpenCV's IPPE),
   and of rendered frames read by detectors, there with the noise measured of what tells the poses apart;
3. the share of wrong poses among simulated views that localise, of one tag and of two side by side.

With runs of `optimise`: what detectors and PnP make of rendered frames of their deployments.
"""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from statistics import NormalDist

import cv2
import numpy as np
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from lmd.core.checks import FloatArray
from lmd.detection.detectors import AprilTagDetector, ArucoDetector, Detector
from lmd.detection.frames import detect_in_frames, draw_poses, tagged_room
from lmd.estimation.pnp import likely
from lmd.geometry.camera import Camera
from lmd.geometry.pose import pose_error, solutions
from lmd.geometry.projection import intrinsics, project
from lmd.geometry.se3 import camera_pose
from lmd.geometry.squares import corners
from lmd.objectives.localisation.ambiguity import CONFIDENCE, mirrored_square
from lmd.objectives.localisation.information import deviation_per_variance, moments, variance
from lmd.pipelines.app import CONF
from lmd.pipelines.building import build_problem
from lmd.problem import Problem
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom
from lmd.scene.deployment import Deployment
from lmd.scene.tag import Tag

EDGE, NOISE = 0.15, 0.5  # metres, pixels
DISTANCES, INCIDENCES = (1.5, 2.5, 3.5, 5.0), (10, 25, 45, 60)
SIMULATED, RENDERED, FRAMES, REPEATS = 1000, 200, 500, 5
NORMAL, UP, RIGHT = np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 1.0, 0.0]])
OFF = 15.0  # greatest angle of a tag from the middle of the image along each axis, degrees
DETECTORS: dict[str, Detector] = {"AprilTag": AprilTagDetector(), "ArUco": ArucoDetector(preset="fine")}
WRONG = 0.25  # metres, by which a mirrored pose is off at the least


def lab() -> Problem:
    """The problem of `experiment=lab`."""
    with initialize_config_dir(CONF, version_base="1.3"):
        return build_problem(compose("optimise", ["experiment=lab"]))


def views(
    count: int, distance: float, incidence: float, rng: np.random.Generator, turn: float | None = None
) -> FloatArray:
    """Poses `(count, 4, 4)` that see what hangs at the origin at an incidence, degrees, from all sides.

    The cameras detect_in_frames past it by a `turn` to the side, degrees, None for a random one.
    """
    slant, around = np.radians(incidence), rng.uniform(-np.pi, np.pi, count)
    away = np.stack([np.full(count, np.cos(slant)), np.sin(slant) * np.cos(around), np.sin(slant) * np.sin(around)], 1)
    turns = np.radians(rng.uniform(-OFF, OFF, (2, count)) if turn is None else [[turn], [0.0]])
    yaw, pitch = np.arctan2(-away[:, 0], -away[:, 1]) + turns[0], np.arcsin(-away[:, 2]) + turns[1]
    return camera_pose(distance * away, yaw, pitch)


def residual(camera: Camera, poses: FloatArray, edge: float) -> FloatArray:
    """sqrt(S) of a tag at the origin, pixels, `(N,)`."""
    half, offset = edge / 2.0, -poses[:, :3, 3]
    depth = (poses[:, :3, 2] * offset).sum(axis=1)
    square = mirrored_square((offset.T, half * RIGHT.T, half * UP.T)) / depth**3
    return np.sqrt(square) / deviation_per_variance(camera, 1.0)


def share_wrong(camera: Camera, poses: FloatArray, edge: float, noise: float) -> FloatArray:
    """P of each view, `(N,)`."""
    return np.array([NormalDist().cdf(-each / (2.0 * noise)) for each in residual(camera, poses, edge)])


def candidates(camera: Camera, points: FloatArray, image: FloatArray) -> list[tuple[float, FloatArray]]:
    """Squared residual and R, world to camera, of IPPE's poses, refined; the better first."""
    matrix, found = intrinsics(camera), []
    _, turns, shifts, _ = cv2.solvePnPGeneric(points, image, matrix, None, flags=cv2.SOLVEPNP_IPPE)
    for each in zip(turns, shifts, strict=True):
        turn, shift = cv2.solvePnPRefineLM(points, image, matrix, None, *each)
        off = cv2.projectPoints(points, turn, shift, matrix, None)[0][:, 0] - image
        found.append((float((off**2).sum()), cv2.Rodrigues(turn)[0]))
    return sorted(found, key=lambda one: one[0])


def is_mirrored(pose: FloatArray, turn: FloatArray) -> bool:
    """Return whether a rotation R, world to camera, is nearer to the mirrored pose than to the true one."""
    normal, line = pose[:3, :3].T @ NORMAL[0], pose[:3, :3].T @ -pose[:3, 3]
    line /= np.linalg.norm(line)
    other = normal - 2.0 * (normal @ line) * line
    return bool((turn @ NORMAL[0]) @ (-other - normal) > 0.0)


def simulated(camera: Camera, poses: FloatArray, points: FloatArray, rng: np.random.Generator) -> float:
    """Share of wrong poses with noise on projected corners `(M, 3)`."""
    images = project(camera, poses, points) + rng.normal(0.0, NOISE, (len(poses), len(points), 2))
    best = [candidates(camera, points, image)[0][1] for image in images]
    return float(np.mean([is_mirrored(pose, turn) for pose, turn in zip(poses, best, strict=True)]))


def square(edge: float, shift: float = 0.0) -> FloatArray:
    """Corners of a tag at the origin, shifted to its right, `(4, 3)`."""
    return corners(shift * RIGHT, NORMAL, UP, edge)[0]


def closed_form(camera: Camera, rng: np.random.Generator) -> Iterator[str]:
    """Rows of the first table."""
    for off in (0.0, 15.0, 30.0):
        ratios = []
        for edge in (0.05, 0.15, 0.3):
            for incidence in (15, 30, 45, 60):
                poses = views(12, 2.5, incidence, rng, off)
                points = square(edge)
                others = [candidates(camera, points, image)[-1][0] for image in project(camera, poses, points)]
                ratios += list(residual(camera, poses, edge) / np.sqrt(others))
        low, middle, high = np.quantile(ratios, [0.05, 0.5, 0.95])
        yield f"| {off:g} | {low:.2f} | {middle:.2f} | {high:.2f} |"


def by_distance(camera: Camera, rng: np.random.Generator) -> Iterator[str]:
    """Rows of the second table."""
    tag = Tag(EDGE)
    renderer = Renderer(camera, TaggedRoom(tag, np.array([0]), np.zeros((1, 3)), NORMAL, UP), Imaging())
    points = square(EDGE)
    for distance in DISTANCES:
        for incidence in INCIDENCES:
            poses = views(SIMULATED, distance, incidence, rng)
            told = share_wrong(camera, poses, EDGE, NOISE).mean()
            row = f"| {distance:g} | {incidence} | {told:.3f} | {simulated(camera, poses, points, rng):.3f} |"
            poses = views(RENDERED, distance, incidence, rng)
            exact = project(camera, poses, points)
            for sighting in detect_in_frames(renderer, DETECTORS, poses, 0, int(rng.integers(2**31))).values():
                found = np.flatnonzero(sighting.detected[:, 0])
                if len(found) < RENDERED // 4:
                    row += " |" * 4
                    continue
                read = sighting.corners[found, 0]
                off = (
                    read - exact[found]
                )  # of it, what looks like another pose: the ends of a diagonal against the others
                sigma = float(np.sqrt(((off[:, ::2].sum(axis=1) - off[:, 1::2].sum(axis=1)) ** 2).mean()) / 2.0)
                best = [solutions(camera, points, image)[0].pose[:3, :3].T for image in read]
                wrong = np.mean([is_mirrored(poses[i], turn) for i, turn in zip(found, best, strict=True)])
                told = share_wrong(camera, poses[found], EDGE, sigma).mean()
                row += f" {len(found) / RENDERED:.2f} | {sigma:.2f} | {told:.3f} | {wrong:.3f} |"
            yield row


def deviation(camera: Camera, poses: FloatArray, edge: float, shifts: tuple[float, ...]) -> FloatArray:
    """Predicted standard deviation of the position with tags at these places, metres, `(N,)`."""
    half, numbers = edge / 2.0, np.zeros((15, len(poses)))
    for shift in shifts:
        offset = shift * RIGHT - poses[:, :3, 3]
        depth = (poses[:, :3, 2] * offset).sum(axis=1)
        numbers += np.array(moments((offset.T, half * RIGHT.T, half * UP.T), 1.0)) / depth**3
    value, fixed = variance(numbers, 0, 1)
    return np.where(fixed, deviation_per_variance(camera, NOISE) * np.sqrt(value), np.inf)


def localised(camera: Camera, rng: np.random.Generator) -> Iterator[str]:
    """Rows of the third table: views from 1 to 5 m, 3 to 65 degrees."""
    for edge in (0.05, 0.1, 0.15):
        drawn = [views(1, d, i, rng)[0] for d, i in zip(*rng.uniform([[1], [3]], [[5], [65]], (2, 6000)), strict=True)]
        poses, beside = np.array(drawn), Tag(edge).paper_edge
        told = share_wrong(camera, poses, edge, NOISE) <= 1.0 - CONFIDENCE
        one, two = (deviation(camera, poses, edge, shifts) for shifts in ((0.0,), (-beside / 2.0, beside / 2.0)))
        pair = np.concatenate([square(edge, -beside / 2.0), square(edge, beside / 2.0)])
        for tolerance in (0.02, 0.05):
            row = f"| {100 * edge:g} | {1e3 * tolerance:g} |"
            for which, points in (
                (one <= tolerance, square(edge)),
                ((one <= tolerance) & told, square(edge)),
                (two <= tolerance, pair),
            ):
                share = (
                    f"{simulated(camera, poses[which].repeat(REPEATS, axis=0), points, rng):.4f}" if which.any() else ""
                )
                row += f" {which.mean():.3f} | {share} |"
            yield row


def found_in(runs: list[str]) -> Iterator[str]:
    """Rows of what the objective says of deployments, and what detectors and PnP make of rendered frames of them."""
    for run in map(Path, runs):
        problem = build_problem(OmegaConf.load(run / ".hydra/config.yaml"))
        scene, deployment = problem.scene, Deployment.from_csv(run / "landmarks.csv")
        landmarks = deployment.positions[None], deployment.normals[None]
        told, anyhow = (
            replace(problem.objective, ambiguity=each).values(problem.evaluator, *landmarks).mean()
            for each in ("resolved", "ignored")
        )
        renderer = Renderer(scene.camera, tagged_room(scene.room, deployment, scene.tag), Imaging())
        poses = draw_poses(scene, FRAMES, 0)
        for name, sighting in detect_in_frames(renderer, DETECTORS, poses, 0, 0).items():
            found = [fitted(scene.camera, renderer.room.corners, image) for image in sighting.corners]
            off = pose_error(poses, np.array([each[0] for each in found]))[0]
            sure, alone = np.array([each[1] for each in found]), sighting.detected.sum(axis=1) == 1
            near, wrong = off <= problem.objective.tolerance, off > WRONG
            shares = (
                np.isfinite(off),
                near,
                wrong,
                sure & near,
                sure & wrong,
                alone,
                alone & sure & near,
                alone & wrong,
            )
            yield f"| {run.name} | {told:.3f} | {anyhow:.3f} | {name} |" + "".join(f" {x.mean():.3f} |" for x in shares)


def fitted(camera: Camera, points: FloatArray, image: FloatArray) -> tuple[FloatArray, bool]:
    """The pose that fits an image `(K, 4, 2)` best, NaN for none, and whether it is told from all others."""
    seen = np.isfinite(image[:, 0, 0])
    found = solutions(camera, points[seen].reshape(-1, 3), image[seen].reshape(-1, 2), NOISE)
    return (found[0].pose, len(likely(found)) == 1) if found else (np.full((4, 4), np.nan), False)


def table(title: str, head: str, rows: Iterator[str]) -> None:
    """Print a table row by row, as the rows are computed."""
    print(f"\n{title}\n\n| {head} |\n|{' --- |' * (head.count('|') + 1)}")
    for row in rows:
        print(row, flush=True)


def main() -> None:
    """Print the tables."""
    if runs := sys.argv[1:]:
        shares = "a pose | within the tolerance | > 250 mm off | sure: within | sure: > 250 mm off"
        alone = "one tag | sure: within | > 250 mm off"
        head = f"run | L, resolved | L, ignored | detector | {shares} | {alone}"
        table(f"{FRAMES} frames, shares", head, found_in(runs))
        return
    camera, rng = lab().scene.camera, np.random.default_rng(0)
    print(f"Focal length {1.0 / deviation_per_variance(camera, 1.0):.0f} pixels, noise {NOISE:g}.")
    table("Closed form over residual", "off axis, degrees | 5 % | median | 95 %", closed_form(camera, rng))
    each = " | ".join(f"{name}: found | sigma, px | predicted | wrong" for name in DETECTORS)
    head = f"distance, m | incidence, degrees | predicted | simulated | {each}"
    table("Share of wrong poses", head, by_distance(camera, rng))
    head = "edge, cm | tolerance, mm | ignored: views | wrong | resolved: views | wrong | two tags: views | wrong"
    table("Views that localise, and how many of these are wrong", head, localised(camera, rng))


if __name__ == "__main__":
    main()
