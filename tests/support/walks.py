"""Rooms with tags, walks through them with a camera whose corners have known errors, and surveys of these."""

import cv2
import numpy as np

from lmd.adjust.intrinsics import Optics
from lmd.adjust.sightings import Observations, Sightings
from lmd.core.checks import FloatArray
from lmd.detection.corner_errors import CornerErrors
from lmd.formats.detections import DetectedTags
from lmd.geometry.camera import Camera
from lmd.geometry.projection import project
from lmd.geometry.se3 import act, camera_pose, exp, inverse, log, pose_of, rigid_alignment
from lmd.geometry.squares import CORNERS
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom
from lmd.scene.tag import Tag
from lmd.space.cuboid import Cuboid
from lmd.survey.knowledge import PriorKnowledge
from lmd.survey.survey import survey

CAMERA = Camera(5.0, 0.0048, 0.0048, (800.0, 600.0), 1600, 1200, 0.0)
EDGE = 0.10
SMALLEST = 12.0  # shortest side that is detected, pixels
NEARLY_SIDEWAYS = 0.2  # cosine of the steepest incidence


def on_wall(wall, along, height, width=5.0, depth=4.0):
    """Pose of a tag flat on one of four walls, `(4, 4)`: x right, y up, z out; `along` is a share of its length."""
    up, x, y = np.array([0.0, 0.0, 1.0]), along * width, along * depth
    centre, normal = [
        ((x, 0.0, height), (0.0, 1.0, 0.0)),
        ((0.0, y, height), (1.0, 0.0, 0.0)),
        ((x, depth, height), (0.0, -1.0, 0.0)),
        ((width, y, height), (-1.0, 0.0, 0.0)),
    ][wall]
    return pose_of(np.stack([np.cross(up, normal), up, normal], axis=-1), np.array(centre))


def wall_tags(count, rng, height=2.5):
    """Tags flat on the four walls of a room in turns, `(K, 4, 4)`, some of which may overlap."""
    heights, along = rng.uniform(0.3, height - 0.3, count), rng.uniform(0.07, 0.93, count)
    return np.stack([on_wall(k % 4, along[k], heights[k]) for k in range(count)])


def spaced_tags(count, rng):
    """Tags flat on the four walls in turns that do not overlap, `(K, 4, 4)`."""
    each = -(-count // 4)
    return np.stack([on_wall(k % 4, (k // 4 + 0.5) / each, rng.uniform(0.8, 1.8)) for k in range(count)])


def hung(poses, rng, place=0.010, turn=0.009):
    """Poses with errors of hanging, in the plane of the wall and, a tenth of these, off it."""
    twist = rng.normal(size=(len(poses), 6)) * [turn / 4, turn / 4, turn, place, place, place / 10]
    return poses @ exp(twist)


def walk(frames, rng, width=5.0, depth=4.0):
    """Poses of a camera that looks around at eye level, `(F, 4, 4)`."""
    place = rng.uniform([1.2, 1.0, 1.0], [width - 1.2, depth - 1.0, 1.7], (frames, 3))
    yaw, pitch, roll = rng.uniform(-np.pi, np.pi, frames), rng.normal(0.0, 0.15, frames), rng.normal(0.0, 0.1, frames)
    return camera_pose(place, yaw, pitch, roll)


def photographed(tags, frames, rng, sigma=0.2, camera=CAMERA, mounts=None, edges=EDGE, ids=None):
    """Detections with errors of `sigma` pixels in each coordinate."""
    mounts = np.eye(4)[None] if mounts is None else mounts
    square = np.hstack([CORNERS, np.zeros((4, 1))]) / 2.0
    edges = np.broadcast_to(edges, len(tags))
    points = (edges[:, None, None] * square) @ np.swapaxes(tags[:, :3, :3], 1, 2) + tags[:, None, :3, 3]
    ids = np.arange(len(tags)) if ids is None else ids
    rows = []
    for f, body in enumerate(frames):
        for c, mount in enumerate(mounts):
            pose = body @ mount
            image = project(camera, pose, points.reshape(-1, 3)).reshape(-1, 4, 2)
            towards = pose[:3, 3] - tags[:, :3, 3]
            facing = (towards * tags[:, :3, 2]).sum(axis=1) / np.linalg.norm(towards, axis=1)
            size = [camera.image_width, camera.image_height]
            sides = np.linalg.norm(image - np.roll(image, 1, axis=1), axis=-1).min(axis=1)
            inside = ((image > 2.0) & (image < np.subtract(size, 2.0))).all(axis=(1, 2))
            for k in np.flatnonzero(inside & (facing > NEARLY_SIDEWAYS) & (sides > SMALLEST)):
                rows.append((f, c, ids[k], image[k] + rng.normal(0.0, sigma, (4, 2))))
    frame, camera_index, number, corners = (np.array(column) for column in zip(*rows, strict=True))
    names = tuple(f"camera {c}" for c in range(len(mounts))) if len(mounts) > 1 else ("",)
    return DetectedTags(tuple(map(str, range(len(frames)))), names, frame, camera_index, number, corners)


def constant_errors(sigma):
    """Corner errors with one standard deviation of every coordinate, pixels, at any pitch."""
    rms = sigma * np.sqrt(2.0)
    return CornerErrors((1.0, 2.0), (rms, rms), (rms, rms))


def sightings(detected, ids, edges=EDGE, sigma=0.2, camera=CAMERA) -> Sightings:
    """Sightings of a family with eight modules."""
    optics = (Optics(camera),) * len(detected.cameras)
    edge: FloatArray = np.broadcast_to(np.asarray(edges, dtype=np.float64), len(ids)).copy()
    return Observations(detected, optics, np.asarray(ids), edge, 8, constant_errors(sigma)).through()


def one_after_the_other(one: DetectedTags, two: DetectedTags) -> DetectedTags:
    """Join two walks of the same cameras."""
    frames = len(one.times) + len(two.times)
    both = ((getattr(one, name), getattr(two, name)) for name in ("camera", "ids", "corners"))
    camera, ids, corners = (np.concatenate(pair) for pair in both)
    frame = np.concatenate([one.frame, two.frame + len(one.times)])
    return DetectedTags(tuple(map(str, range(frames))), one.cameras, frame, camera, ids, corners)


def surveyed(detected, sigma=0.2, cameras=(CAMERA,), edge=EDGE, calibrate=None, errors=None, **known):
    """Survey of detections with prior knowledge `known`."""
    errors = constant_errors(sigma) if errors is None else errors
    return survey(detected, cameras, Tag(edge), errors, PriorKnowledge(**known), calibrate)


def apart(here, there):
    """Distances of the centres of poses, metres, once these are laid over each other."""
    here, there = here[:, :3, 3], there[:, :3, 3]
    return np.linalg.norm(act(rigid_alignment(here, there), here) - there, axis=1)


def square_of(found, true):
    """Squared normalised error of a tag of an `Estimate` beside the tag of the origin: six degrees of freedom."""
    first = int(np.flatnonzero(found.prior.information.any(axis=1))[0])
    tag = (first + 1) % len(true)
    off = log(inverse(true[tag]) @ true[first] @ found.poses.tags[tag])
    return off @ np.linalg.solve(found.covariances[tag], off)


ROOM = Cuboid((5.0, 4.0, 2.5), (4.0, 3.0, 1.5), 1.0)


def calibration(path, camera):
    """Write the calibration of a camera as ROS does."""
    (focal_u, focal_v), (u, v) = camera.focal_pixels, camera.principal_point
    matrix = [focal_u, 0, u - 0.5, 0, focal_v, v - 0.5, 0, 0, 1]
    path.write_text(
        f"image_width: {camera.image_width:.0f}\nimage_height: {camera.image_height:.0f}\n"
        f"camera_matrix: {{data: {[float(value) for value in matrix]}}}\n"
        f"distortion_model: plumb_bob\ndistortion_coefficients: {{data: [0, 0, 0, 0, 0]}}\n"
    )


def photograph(folder, tags, ids, frames, camera=CAMERA, edge=EDGE, first=0, seed=0):
    """Write a photograph from each of `frames` `(F, 4, 4)`, numbered from `first`."""
    room = TaggedRoom(Tag(edge), ids, tags[:, :3, 3], tags[:, :3, 2], tags[:, :3, 1], ROOM.faces())
    renderer = Renderer(camera, room, Imaging(psf_sigma=0.5, noise=2.0, texture=4.0))
    folder.mkdir(exist_ok=True)
    for number, pose in enumerate(frames, first):
        image = renderer.frame(pose, np.random.default_rng([seed, number]))
        cv2.imwrite(str(folder / f"{number:04d}.png"), image)
