"""Walks through rooms with a map, their localisation, and bounds of its errors."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from lmd.adjust.corners import Poses
from lmd.adjust.estimate import Estimate
from lmd.adjust.intrinsics import Optics
from lmd.adjust.sightings import Observations
from lmd.core.checks import FloatArray
from lmd.formats.detections import DetectedTags
from lmd.geometry.se3 import exp, inverse, log
from lmd.localise.fixed_map import FixedMap
from lmd.localise.localise import Localisation, localise
from lmd.scene.tag import Tag
from support import walks

NOISE = 0.2  # standard deviation of corners, pixels


class Walked(NamedTuple):
    """A walk: the map, the true poses of tags `(K, 4, 4)` and frames `(F, 4, 4)`, and detections."""

    known: FixedMap
    true: FloatArray
    frames: FloatArray
    detected: DetectedTags


def walked(
    seed: int,
    tags: int = 16,
    frames: int = 60,
    place: float = 0.001,
    turn: float = 0.002,
    moved: dict[int, FloatArray] | None = None,
) -> Walked:
    """Walk through a room whose tags hang beside the map with the stated standard deviations, metres and rad.

    Args:
        moved: twists in the frame of each tag by which it was moved since, by index.
    """
    rng = np.random.default_rng(seed)
    plan = walks.spaced_tags(tags, rng)
    sigmas = np.tile([turn] * 3 + [place] * 3, (tags, 1))
    true = plan @ exp(rng.normal(size=(tags, 6)) * sigmas)
    for index, twist in (moved or {}).items():
        true[index] = true[index] @ exp(twist)
    poses = walks.walk(frames, rng)
    known = FixedMap(np.arange(tags), plan, np.full(tags, walks.EDGE), sigmas)
    detected = replace(walks.photographed(true, poses, rng, NOISE), in_order=True)
    return Walked(known, true, poses, detected)


def localised(walk: Walked, detected: DetectedTags | None = None, **more) -> Localisation:
    """Localise a walk."""
    errors = walks.constant_errors(NOISE)
    return localise(detected or walk.detected, [walks.CAMERA], Tag(walks.EDGE), errors, walk.known, **more)


def compared(walk: Walked, moved: Sequence[int] = ()) -> tuple[Estimate, FixedMap]:
    """Estimate with exact cameras in which the tags `moved` have no prior, and the map."""
    ids = walk.known.ids
    optics, errors = (Optics(walks.CAMERA),), walks.constant_errors(NOISE)
    seen = Observations(walk.detected, optics, ids, walk.known.edges, 8, errors)
    prior, poses = walk.known.prior(np.isin(ids, moved)), Poses(walk.known.poses, walk.frames, np.eye(4)[None])
    return Estimate(seen.through(), prior, poses, np.zeros(len(ids), dtype=np.int64)).adjusted(0.0), walk.known


def squares(poses: FloatArray, covariances: FloatArray, true: FloatArray) -> FloatArray:
    """Squared normalised errors of all poses that are known: jointly, of rotation, and of position, `(n, 3)`."""
    known = np.isfinite(poses[:, 0, 0])
    off = log(inverse(poses[known]) @ true[known])
    own = covariances[known]
    parts = (slice(0, 6), slice(0, 3), slice(3, 6))
    return np.stack(
        [np.einsum("ni,nij,nj->n", off[:, p], np.linalg.inv(own[:, p, p]), off[:, p]) for p in parts], axis=1
    )


def check_bounds(square: FloatArray, freedom: int, slack: float = 1.0) -> None:
    """Check that the sum of chi^2 variables lies within the 99 % bounds."""
    low, high = chi2.ppf([0.005, 0.995], freedom * len(square))
    assert low / slack < square.sum() < slack * high, f"{square.sum():.0f} of {freedom * len(square)}"
