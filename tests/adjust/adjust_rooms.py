"""A small room with every factor of a bundle adjustment, whose truth is known and may be drawn from its priors."""

from dataclasses import dataclass, replace

import numpy as np
from support import walks

from lmd.adjust.corners import Poses
from lmd.adjust.intrinsics import Optics, prior_sigmas
from lmd.adjust.motion import Motion
from lmd.adjust.prior import Mounts, Prior, Sheets
from lmd.adjust.refinement import with_nuisances
from lmd.adjust.sightings import Observations
from lmd.geometry.se3 import camera_pose, exp, pose_of
from lmd.geometry.trajectory import Trajectory

TAGS, FRAMES, SIGMA = 5, 10, 0.2
CAMERA = replace(walks.CAMERA, distortion=(-0.1, 0.03, 0.0005, -0.0003, 0.0))
MOUNTS = exp(np.array([[0.0] * 6, [0.02, 0.4, -0.01, 0.2, 0.01, -0.02], [0.01, -0.3, 0.0, -0.1, 0.0, 0.02]]))
# Tags 3 and 4 are on one sheet.
PLAN = np.stack([walks.on_wall(0, x, z) for x, z in ((0.35, 1.4), (0.5, 1.0), (0.65, 1.5), (0.45, 1.8), (0.49, 1.8))])
ON_SHEET = pose_of(np.eye(3), np.array([[0.0, 0.0, 0.0], [-0.2, 0.0, 0.0]]))
SHEETS = Sheets(
    np.array([3, 4]), np.zeros(2, dtype=int), ON_SHEET, np.array([0.005, 0.005, 0.001, 2e-4, 2e-4, 0.001]) ** -2.0
)
TIMES = 0.1 * np.arange(FRAMES)
PRIOR_SIGMAS = np.repeat([0.003, 0.001], 3)
FACTORS = ("independent", "joint", "sheets", "odometry", "constant velocity")


@dataclass(frozen=True)
class Room:
    """Detections in a room, its truth, and the prior from which the truth was drawn."""

    seen: Observations
    prior: Prior
    true: Poses

    def sightings(self, nuisances=False):
        """Sightings, with the derivatives of lenses and shapes as well."""
        some, sigmas = self.seen.through(), np.append(prior_sigmas(CAMERA), [0.1, 0.05])
        if not nuisances:
            return some
        some = replace(some, shape_sigma=3e-4, size_sigmas=np.full(TAGS, 1e-3))
        return with_nuisances(some, self.seen.optics, [sigmas] * some.cameras, self.true)


def smooth(rng):
    """Frames that look at the wall from a slow walk, `(F, 4, 4)`."""
    t = TIMES + rng.uniform(0.0, 6.0)
    places = np.stack([2.5 + 0.5 * np.sin(t), 1.9 + 0.3 * np.cos(1.3 * t), 1.4 + 0.1 * np.sin(2.0 * t)], axis=1)
    return camera_pose(places, np.pi + 0.3 * np.sin(1.7 * t), 0.05 * np.cos(t), 0.05 * np.sin(t))


def drawn(factors, seed=0, sigma=SIGMA):
    """Draw a room with three mounts from the priors that `factors` name."""
    rng = np.random.default_rng(seed)
    size, frames, tags, motion, joint = 6 * TAGS, smooth(rng), PLAN, None, None
    information = np.tile(PRIOR_SIGMAS**-2.0, (TAGS, 1))
    if "joint" in factors:
        half = rng.normal(size=(size, size)) * np.tile(PRIOR_SIGMAS, TAGS)[:, None] / np.sqrt(size)
        covariance = half @ half.T + np.diag(np.tile(PRIOR_SIGMAS, TAGS) ** 2) / 9.0
        joint = np.linalg.inv(covariance)
        tags = PLAN @ exp(rng.multivariate_normal(np.zeros(size), covariance).reshape(-1, 6))
    elif "sheets" in factors:
        information[3:] = 0.0
        off = rng.normal(size=(2, 6)) * SHEETS.information**-0.5
        tags = np.concatenate([PLAN[:3], PLAN[3] @ exp(0.1 * rng.normal(size=6)) @ ON_SHEET @ exp(off)])
    if joint is None:
        tags = tags @ exp(rng.normal(size=(TAGS, 6)) * np.where(information > 0.0, PRIOR_SIGMAS, 0.0))
    off = rng.normal(size=(2, 6)) * np.repeat([0.0175, 0.01], 3)
    mounts = np.concatenate([MOUNTS[:1], MOUNTS[1:] @ exp(off)])
    if "odometry" in factors:
        motion = replace(Motion.by_odometry(TIMES, Trajectory(TIMES, frames)), spread=(0.05, 0.1))
        links = motion.links(np.arange(FRAMES))
        bias, frames = rng.normal(size=6), frames[:1]
        for step, by_bias, own in zip(links.steps, links.by_bias, links.information, strict=True):
            twist = by_bias @ bias + rng.multivariate_normal(np.zeros(6), np.linalg.inv(own))
            frames = np.concatenate([frames, frames[-1:] @ step @ exp(twist)])
    if "constant velocity" in factors:
        motion, frames, rates = Motion(TIMES, (0.3, 0.3)), frames[:1], np.array([0.0, 0.2, 0.0, 0.2, 0.0, 0.1])
        for h, own in zip(np.diff(TIMES), motion.links(np.arange(FRAMES)).information, strict=True):
            off, change = rng.multivariate_normal(np.zeros(12), np.linalg.inv(own)).reshape(2, 6)
            off = off + h * rates
            following = frames[-1] @ exp(np.r_[off[:3], 0.0, 0.0, 0.0])
            following[:3, 3] += off[3:]
            frames, rates = np.concatenate([frames, following[None]]), rates + change
    given = Mounts(MOUNTS, (0.0175, 0.01))
    prior = Prior(PLAN, information, SHEETS if "sheets" in factors else None, given, motion, joint)
    detected = walks.photographed(tags, frames, rng, sigma, CAMERA, mounts)
    errors = replace(walks.constant_errors(SIGMA), inward_spread=0.1)
    seen = Observations(detected, (Optics(CAMERA),) * 3, np.arange(TAGS), np.full(TAGS, walks.EDGE), 8, errors)
    return Room(seen, prior, Poses(tags, frames, mounts))


def astray(poses, rng, by=1.0):
    """Poses somewhat off, and the twists by which they are."""
    twists = [rng.normal(size=(len(own), 6)) * 1e-3 * by for own in (poses.tags, poses.frames, poses.mounts)]
    twists[2][0] = 0.0
    return moved(poses, twists), twists


def moved(poses, twists, by=1.0):
    """Poses after `by` times the twists of tags, frames and mounts."""
    return Poses(
        *(own @ exp(by * twist) for own, twist in zip((poses.tags, poses.frames, poses.mounts), twists, strict=True))
    )


def turned(poses, motion):
    """Poses after a motion of the world."""
    return replace(poses, tags=motion @ poses.tags, frames=motion @ poses.frames)
