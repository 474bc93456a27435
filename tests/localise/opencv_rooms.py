"""Scenarios of localisation whose images are made by OpenCV's projection, which shares no code with `lmd`."""

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from support import walks

from lmd.core.checks import FloatArray
from lmd.formats.detections import DetectedTags
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import camera_pose, exp, inverse, log, pose_of
from lmd.geometry.trajectory import Trajectory
from lmd.localise.fixed_map import FixedMap
from lmd.localise.localise import Drive, Localisation, localise
from lmd.scene.tag import Tag

RATE, EDGE, ODD_EDGE, SIGMA = 5.0, 0.2, 0.125, 0.2  # images a second; metres; pixels
# Focal lengths and principal point from the centre of the first pixel, coefficients, and size.
WIDE = (780.0, 781.5, 642.3, 396.8), (-0.12, 0.06, 0.0005, -0.0004, 0.0), (1280, 800)
SMALL = (455.0, 454.2, 319.2, 241.9), (-0.03, 0.01, 0.0, 0.0, 0.0), (640, 480)
LONG = (1507.0, 1506.3, 641.2, 524.5), (-0.233, 0.218, 0.0001, -0.0001, -0.0913), (1280, 1024)
SECOND = pose_of(cv2.Rodrigues(np.array([0.0, 2.8, 0.0]))[0], np.array([0.05, 0.0, -0.35]))  # looks back
SQUARE = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]]) / 2.0
ERRORS = np.repeat([0.003, 0.001], 3)  # of the map: rad and metres
RIGS = ("rig", "mount turned", "mount shifted")
NAMES = ("plain", "moved", *RIGS, "plane", "sizes", "twice")


class Scenario(NamedTuple):
    """True poses of frames and of tags, and the input of a localisation."""

    frames: FloatArray
    true: FloatArray
    detected: DetectedTags
    cameras: list[Camera]
    known: FixedMap
    mounts: FloatArray | None
    sigma: float

    def localised(self, odometry: Trajectory | None = None, **more) -> Localisation:
        errors = replace(walks.constant_errors(self.sigma), inward_spread=0.1)
        tag = Tag(float(self.known.edges[0]))
        return localise(self.detected, self.cameras, tag, errors, self.known, Drive(self.mounts, odometry), **more)


def camera_of(lens) -> Camera:
    """Camera with a lens."""
    (fx, fy, u, v), distortion, size = lens
    return Camera(1.0, 1.0 / fx, 1.0 / fy, (u + 0.5, v + 0.5), *size, 0.0, distortion=distortion)


def images(points, normals, frames, lenses, mounts, rng, sigma):
    """Rows of frame, camera, index of the tag, and corners, of tags with corners `points` `(K, 4, 3)`."""
    rows = []
    for f, c in np.ndindex(len(frames), len(lenses)):
        (fx, fy, u, v), distortion, size = lenses[c]
        matrix, pose = np.array([[fx, 0.0, u], [0.0, fy, v], [0.0, 0.0, 1.0]]), frames[f] @ mounts[c]
        seen = (points - pose[:3, 3]) @ pose[:3, :3]
        ahead = (seen[..., 2].min(axis=1) > 0.2) & (np.hypot(*seen.T[:2]).T / seen[..., 2] < 1.2).all(axis=1)
        way = pose[:3, 3] - points.mean(axis=1)
        for k in np.flatnonzero(ahead & ((way * normals).sum(axis=1) > 0.2 * np.linalg.norm(way, axis=1))):
            image = cv2.projectPoints(seen[k], np.zeros(3), np.zeros(3), matrix, np.array(distortion))[0][:, 0] + 0.5
            inside = (image > 2.0).all() and (image < np.subtract(size, 2.0)).all()
            if inside and np.linalg.norm(image - np.roll(image, 1, axis=0), axis=1).min() > 12.0:
                rows.append((f, c, k, image + rng.normal(0.0, sigma, (4, 2))))
    return (np.array(column) for column in zip(*rows, strict=True))


def way(rng, metres):
    """Twist of a shift in a random direction."""
    direction = rng.normal(size=3)
    return np.r_[0.0, 0.0, 0.0, metres * direction / np.linalg.norm(direction)]


def room(rng):
    """16 tags on the walls of a room of 8 x 5 metres, `(16, 4, 4)`."""
    along = [
        walks.on_wall(wall, x / 8.0, rng.uniform(1.1, 1.5), 8.0, 5.0)
        for x in (0.8, 2.4, 4.0, 5.6, 7.2)
        for wall in (0, 2)
    ]
    return np.stack(along + [walks.on_wall(wall, y / 5.0, 1.35, 8.0, 5.0) for y in (1.0, 2.5, 4.0) for wall in (1, 3)])


def drive(rng, count):
    """A cart that circles in the room and looks around."""
    t, phase = np.arange(count) / RATE, rng.uniform(0.0, 2.0 * np.pi, 6)
    x, y = 4.0 + 2.6 * np.cos(2.0 * np.pi * t / 60.0 + phase[0]), 2.5 + 1.2 * np.sin(2.0 * np.pi * t / 30.0 + phase[1])
    places = np.stack([x, y, 0.7 + 0.02 * np.sin(0.9 * t + phase[2])], axis=1)
    return camera_pose(
        places,
        0.25 * t + 0.5 * np.sin(0.57 * t + phase[3]) + phase[4],
        0.1 + 0.03 * np.sin(1.26 * t + phase[5]),
        0.0 * t,
    )


def still(rng, count):
    """A camera before a plane that hardly moves."""
    t, phase = np.arange(count) / RATE, rng.uniform(0.0, 6.0, 3)
    turns = np.stack(
        [0.14 + 0.02 * np.sin(t / 4.0 + phase[0]), -0.1 + 0.02 * np.sin(t / 3.0 + phase[1]), 0.015 * np.sin(t / 6.0)], 1
    )
    places = np.stack(
        [-0.41 + 0.05 * np.sin(t / 3.0), -1.1 + 0.04 * np.sin(t / 2.1), 3.45 + 0.1 * np.sin(t / 5.0 + phase[2])], 1
    )
    return pose_of(
        (pose_of(np.diag([1.0, -1.0, -1.0]), np.zeros(3)) @ exp(np.hstack([turns, 0.0 * turns])))[:, :3, :3], places
    )


def scenario(name: str, seed: int, count: int = 200) -> Scenario:
    """One of `NAMES`, with errors of the map as it states them."""
    rng, lenses, mounts, given, sigma = np.random.default_rng(seed), [WIDE], np.eye(4)[None], None, SIGMA
    if name == "plane":
        plan = pose_of(
            np.tile(np.eye(3), (3, 1, 1)), np.array([[0.0, 0.0, 0.0], [-0.913, -1.029, -0.02], [0.809, -1.067, -0.03]])
        )
        frames, lenses, sigma = still(rng, count), [LONG], 0.06
        true, edges, prints = plan, np.full(3, 0.16), rng.normal(0.0, 2e-4, (3, 4, 2))
        stated = edges
    else:
        plan, frames = room(rng), drive(rng, count)
        true, edges, prints = plan @ exp(rng.normal(size=(16, 6)) * ERRORS), np.full(16, EDGE), np.zeros((16, 4, 2))
        stated = edges.copy()
    ids = np.arange(len(plan))
    if name == "moved":
        tag = rng.integers(16)
        true[tag] = true[tag] @ exp(way(rng, 0.03))
    if name == "sizes":
        edges[plan[:, 0, 3] < 3.0] = ODD_EDGE
    if name == "twice":
        twin = plan[[3]].copy()
        twin[0, :3, 3] += [0.8 * rng.choice([-1.0, 1.0]), 0.0, 0.5]
        true, edges, ids = np.concatenate([true, twin]), np.append(edges, EDGE), np.append(ids, 0)
        prints = np.zeros((17, 4, 2))
    if name in RIGS:
        lenses, mounts = [WIDE, SMALL], np.stack([np.eye(4), SECOND])
        off = {"rig": 0.0, "mount turned": np.roll(way(rng, np.radians(1.0)), 3), "mount shifted": way(rng, 0.01)}[name]
        given = np.stack([np.eye(4), SECOND @ exp(off * np.ones(6))])
    shapes = edges[:, None, None] * SQUARE + np.dstack([prints, np.zeros(prints.shape[:2])])
    points = shapes @ np.swapaxes(true[:, :3, :3], 1, 2) + true[:, None, :3, 3]
    frame, camera, tag, corners = images(points, true[:, :3, 2], frames, lenses, mounts, rng, sigma)
    times = tuple(f"{1.7e9 + k / RATE:.3f}" for k in range(count))
    names = ("one", "two")[: len(lenses)]
    detected = DetectedTags(times, names, frame, camera, ids[tag], corners, in_order=True)
    known = FixedMap(np.arange(len(plan)), plan, stated, np.tile(ERRORS, (len(plan), 1)))
    return Scenario(frames, true[: len(plan)], detected, list(map(camera_of, lenses)), known, given, sigma)


def figures(one: Scenario, result: Localisation) -> tuple[float, float, float]:
    """Mean chi^2/6 of the smoothed poses, and medians of their errors and of their stated errors, metres."""
    found = result.smoothed
    assert found is not None
    known = found.poses.known_frames
    off, own = log(inverse(found.poses.frames[known]) @ one.frames[known]), found.frame_covariances[known]
    square = np.einsum("ni,nij,nj->n", off, np.linalg.inv(own), off) / 6.0
    stated = np.sqrt(np.linalg.eigvalsh(own[:, 3:, 3:])[:, -1])
    return float(square.mean()), float(np.median(np.linalg.norm(off[:, 3:], axis=1))), float(np.median(stated))
