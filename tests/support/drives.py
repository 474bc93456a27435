"""Drives: down a corridor with tags on both walls, and through the paper's room."""

from dataclasses import dataclass, replace

import numpy as np

from lmd.core.checks import FloatArray
from lmd.estimation.flights import Pace, RandomMotion
from lmd.estimation.recording import Odometry
from lmd.formats.detections import DetectedTags
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import camera_pose, exp, inverse, pose_of
from lmd.geometry.trajectory import Trajectory
from lmd.scene.deployment_sources import UniformDeployment
from lmd.scene.tag import Tag
from lmd.space.changed import DrivenRoom
from support import walks
from support.paper import paper_room, paper_scene

CAMERA = Camera(4.0, 0.008, 0.008, (400.0, 300.0), 800, 600, 0.0)
EDGE, WIDTH = 0.2, 2.4  # of tags and of the corridor, metres
RATE = 20.0  # images a second
SPEED = 0.75  # m/s
# Random drift of odometry after a metre, standard deviations: metres and rad.
DRIFT = (0.01, 0.005)


@dataclass(frozen=True)
class Drive:
    """A drive and its truth.

    Args:
        tags: true poses of tags, `(K, 4, 4)`.
        frames: true poses of the camera, `(F, 4, 4)`.
        times: seconds, `(F,)`.
        detected: detections.
    """

    tags: FloatArray
    frames: FloatArray
    times: FloatArray
    detected: DetectedTags


def drive(
    length: float, count: int, rng: np.random.Generator, alone: float = 0.97, dark: float = 0.3, sway: float = 1.0
) -> Drive:
    """Drive past `count` tags.

    Args:
        length: length of the corridor, metres.
        alone: share of the images with tags that show only one.
        dark: share of the time without tags, in pieces of a second or two.
        sway: factor of the deviations of the camera from a straight drive; 0 for none.
    """
    along = (np.arange(count) + 0.5 + rng.uniform(-0.2, 0.2, count)) * length / count
    side = np.arange(count) % 2
    up = np.array([0.0, 0.0, 1.0])
    normal = np.stack([0.0 * along, 1.0 - 2.0 * side, 0.0 * along], axis=-1)
    centres = np.stack([along, WIDTH * side, 1.3 + rng.normal(0.0, 0.15, count)], axis=-1)
    tags = pose_of(np.stack([np.cross(up, normal), np.broadcast_to(up, normal.shape), normal], axis=-1), centres)
    times = np.arange(int(length / SPEED * RATE)) / RATE

    def waves(size: float, fastest: float) -> FloatArray:
        """Smooth motion: some sines of random phase up to `fastest` hertz."""
        hertz = np.linspace(fastest / 6.0, fastest, 6) * rng.uniform(0.9, 1.1, 6)
        return size * np.sqrt(1.0 / 3.0) * np.sin(2.0 * np.pi * (hertz * times[:, None] + rng.uniform(size=6))).sum(1)

    ahead = SPEED * times + sway * waves(0.1, 0.3)
    places = np.stack([ahead, WIDTH / 2.0 + sway * waves(0.1, 0.3), 1.3 + sway * waves(0.01, 1.0)], axis=-1)
    frames = camera_pose(
        places, np.pi / 2.0 + sway * waves(0.25, 0.5), sway * waves(0.02, 1.0), sway * waves(0.01, 1.0)
    )
    # `drives` look along x: a yaw of pi / 2 of `camera_pose`.
    every = walks.photographed(tags, frames, rng, 0.2, CAMERA, edges=EDGE)
    shown = np.ones(len(times), dtype=bool)
    while shown.mean() > 1.0 - dark:
        begins = rng.integers(len(times))
        shown[begins : begins + int(RATE * rng.uniform(1.0, 2.0))] = False
    order = np.lexsort((rng.uniform(size=len(every)), every.frame))
    rank = np.arange(len(order)) - np.searchsorted(every.frame[order], every.frame[order])
    several = rng.uniform(size=len(times)) > alone
    kept = order[shown[every.frame[order]] & ((rank < 1) | (several[every.frame[order]] & (rank < 2)))]
    detected = replace(every.of(np.sort(kept)), times=tuple(f"{t:.3f}" for t in times))
    return Drive(tags, frames, times, detected)


def odometry(
    driven: Drive, rng: np.random.Generator, drift: tuple[float, float] = DRIFT, lean: tuple[float, float] = (0.0, 0.0)
) -> Trajectory:
    """Odometry of a drive, in a frame of its own.

    Args:
        drift: see `DRIFT`.
        lean: bias of every metre, ahead and in yaw: metres and rad.
    """
    step = inverse(driven.frames[:-1]) @ driven.frames[1:]
    far = np.linalg.norm(step[:, :3, 3], axis=1)[:, None]
    off = rng.normal(size=(len(step), 6)) * np.sqrt(far) * np.repeat(drift[::-1], 3)
    off += far * [0.0, lean[1], 0.0, 0.0, 0.0, lean[0]]
    poses = [np.eye(4)]
    for motion in step @ exp(off):
        poses.append(poses[-1] @ motion)
    return Trajectory(driven.times, np.stack(poses))


SCENE = replace(paper_scene(paper_room(spacing=2.0)), tag=Tag(0.15))
PACE = Pace(speed=1.0, turn_rate=1.0, frame_rate=5.0)
MOTION = RandomMotion(6.0, PACE)
SLOW = Odometry(turn_noise=0.001, motion_noise=0.005)
DEPLOYMENT = UniformDeployment(60).draw(SCENE.room, np.random.default_rng(0))


def along(scene, drives):
    return replace(scene, room=DrivenRoom(scene.room, drives.positions, drives.seconds))
