"""Cameras refined by a drive: a short survey whose plan is the map.

Calibrations are off, light and blur make tags look larger or smaller, and paper bends. These errors are common to all
images of a drive, so that no residual of a single image shows them, and they would look like errors of the map. They
are estimated as a survey does (`lmd.survey.nuisances`), from some images of several tags, with the map as the prior.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lmd.core.checks import FloatArray
from lmd.detection.corner_errors import CornerErrors
from lmd.formats.detections import DetectedTags
from lmd.geometry.camera import Camera
from lmd.localise.fixed_map import FixedMap, information_of, rows_of
from lmd.localise.image_poses import ImagePoses
from lmd.scene.tag import Tag
from lmd.survey.initialisation import FLOOR_PIXELS
from lmd.survey.intrinsics import Calibrated, prior_sigmas
from lmd.survey.map_estimate import adjust
from lmd.survey.nuisances import LEAST_SHIFT, SMALL_SHARE, Optics, edge_doubts, refine, with_nuisances
from lmd.survey.prior import Prior
from lmd.survey.residuals import Poses
from lmd.survey.sightings import Sightings, sightings_of

# Least and greatest number of images of several tags by which cameras are refined.
FEWEST_IMAGES, MOST_IMAGES = 20, 120


@dataclass(frozen=True)
class RefinedOptics:
    """Cameras of a drive, shifts of corners in their images, and shapes of tags."""

    cameras: tuple[Optics, ...]
    """Optics of each camera."""
    sigmas: tuple[FloatArray, ...] = ()
    """Prior standard deviations of each camera's values, `(P + 2,)`; empty if cameras are exact."""
    covariances: FloatArray | None = None
    """Covariance of each camera's values, in units of `sigmas`, `(C, 6 L, 6 L)`; None if cameras are exact."""
    ids: tuple[int, ...] = ()
    """Ids of tags with a known shape."""
    shapes: FloatArray | None = None
    """Their shapes, `(K, 6)`, see `Sightings.shapes`; None if tags count as flat squares."""
    shape_sigma: float = 0.0
    """Standard deviation of shapes, metres."""
    doubts: tuple[str, ...] = ()
    """Sentences on the edge of the tags, see `edge_doubts`."""

    def calibrated(self, given: Sequence[Camera]) -> tuple[Calibrated, ...]:
        """Cameras beside the `given` ones; empty if cameras are exact."""
        if self.covariances is None:
            return ()
        rows = zip(given, self.cameras, self.covariances, self.sigmas, strict=True)
        return tuple(
            Calibrated.of(camera, one.camera, one.shifts[0], own[: len(sigma), : len(sigma)] * np.outer(sigma, sigma))
            for camera, one, own, sigma in rows
        )

    @cached_property
    def shifts(self) -> FloatArray:
        """Shifts of corners in each camera's images, `(C, 2)`, pixels."""
        return np.array([one.shifts for one in self.cameras])

    def sightings(
        self, detected: DetectedTags, known: FixedMap, tag: Tag, errors: CornerErrors, more: Sequence[int] = ()
    ) -> Sightings:
        """Sightings of the tags of the map, and of the tags `more`, through these cameras."""
        ids = np.union1d(known.ids, np.array(more, dtype=np.int64))
        edges = np.full(len(ids), np.median(known.edges) if tag.is_point else tag.size)
        edges[np.searchsorted(ids, known.ids)] = known.edges
        through = [one.camera for one in self.cameras]
        some = sightings_of(detected, through, ids, edges, tag.modules, errors, self.shifts)
        if self.shapes is None:
            return some
        shapes = np.zeros((len(ids), 6))
        shapes[np.searchsorted(ids, self.ids)] = self.shapes
        return replace(some, shapes=shapes, shape_sigma=self.shape_sigma)

    def with_errors(self, some: Sightings, known: FixedMap, found: ImagePoses) -> Sightings:
        """Sightings with the derivatives by these cameras' values, at the poses of the map and of images."""
        if not self.sigmas:
            return some
        tags = np.full((len(some.ids), 4, 4), np.nan)
        tags[np.searchsorted(some.ids, known.ids)] = known.poses
        return with_nuisances(some, self.cameras, self.sigmas, replace(found.poses, tags=tags))


def refined_optics(
    detected: DetectedTags,
    cameras: Sequence[Camera],
    tag: Tag,
    errors: CornerErrors,
    known: FixedMap,
    found: ImagePoses,
) -> RefinedOptics:
    """Refine cameras by a drive; too few images of several tags leave them as given.

    Args:
        detected: detections.
        cameras, tag, errors, known: see `lmd.localise.localise.localise`.
        found: poses of images through the given cameras.
    """
    given = RefinedOptics(tuple(Optics(camera) for camera in cameras))
    some = found.sightings
    several = np.flatnonzero(np.bincount(some.frame[found.used], minlength=some.frames) > 1)
    if len(several) < FEWEST_IMAGES:
        return given
    chosen = several[:: -(-len(several) // MOST_IMAGES)]
    part = detected.of(np.flatnonzero(np.isin(detected.frame, chosen)))
    seen = np.unique(some.tag[np.isin(some.frame, chosen)])
    rows = rows_of(seen)
    shown = replace(known, ids=known.ids[seen], poses=known.poses[seen], edges=known.edges[seen],
                    sigmas=known.sigmas[seen], covariance=known.joint[np.ix_(rows, rows)])  # fmt: skip
    spread = np.maximum([errors.inward_spread, SMALL_SHARE * errors.inward_spread], LEAST_SHIFT)
    sigmas = tuple(np.append(prior_sigmas(camera), spread) for camera in cameras)

    def sighted(through: Sequence[Optics]) -> Sightings:
        return RefinedOptics(tuple(through)).sightings(part, shown, tag, errors)

    start = sighted(given.cameras)
    frames = np.where(np.isin(np.arange(some.frames), chosen)[:, None, None], found.poses.frames, np.nan)
    poses = Poses(shown.poses, frames, found.poses.mounts)
    prior = Prior(shown.poses, shown.sigmas**-2.0, None, poses.mounts, joint=information_of(shown.joint))
    first = adjust(start, prior, poses, np.zeros(len(seen), dtype=np.int64), FLOOR_PIXELS)
    after, optics = refine(first, given.cameras, sigmas, sighted, False, _never, _never)
    shapes, ids = after.sightings.shapes, tuple(shown.ids.tolist())
    doubts = tuple(edge_doubts(after, optics, given.cameras, sigmas, sighted))
    return RefinedOptics(optics, sigmas, after.lens_covariances, ids, shapes, after.sightings.shape_sigma, doubts)


def _never(_done: int, _most: int) -> bool:
    """Return False: a refinement is not stopped."""
    return False
