"""What a detector sees of tags of several sizes: the size of a landmark goes with its index in the deployment.

Compiled code for tags of one size is what it was: it is handed the sight of that size. Only where there are several is
it compiled for a `SizedSight`, of which `lmd.scene.criteria.sized` makes the sight of each landmark, the same numbers
that a scene with tags of its size alone has. What prunes goes by the largest tags.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.compiled import inlined
from lmd.core.dispatch import dispatched, overridable
from lmd.geometry.lens_models import Equidistant
from lmd.scene.criteria import pixel_density, sized
from lmd.sight.models.fiducial_sight import FiducialSight
from lmd.sight.models.lens_sight import LensSight
from lmd.sight.obstacles import half_edge

HALF, PLATE, AREA, SHARP, BLURRED, SHORT_AREA, LONG_AREA = range(7)  # rows: the last two are of the lens's pinholes


class SizedSight(NamedTuple):
    """The criteria as numbers for tags of several sizes; a `lmd.scene.criteria.Sight`.

    largest: of the largest tags; numbers: what depends on the size, `(7, K)`; reach: see `Sight.reach`.
    """

    largest: FiducialSight | LensSight
    numbers: np.ndarray
    reach: float

    @property
    def outer_cosine(self) -> float:
        """See `Sight.outer_cosine`."""
        return self.largest.outer_cosine

    @property
    def inset(self) -> float:
        """See `Sight.inset`."""
        return self.largest.inset

    @property
    def horizon(self) -> float:
        """See `Sight.horizon`."""
        return self.largest.horizon

    @property
    def tabulated(self) -> bool:
        """See `Sight.tabulated`."""
        return self.largest.tabulated

    def unhidden(self) -> "SizedSight":
        """See `Sight.unhidden`."""
        return self._of(self.largest.unhidden())

    def among(self, low: FloatArray, high: FloatArray, landmarks: FloatArray, normals: FloatArray) -> "SizedSight":
        """See `Sight.among`."""
        return self._of(self.largest.among(low, high, landmarks, normals))

    def shrunk(self, size: float) -> "SizedSight":
        """See `Sight.shrunk`."""
        numbers = self.numbers.copy()
        numbers[PLATE] *= size
        return self._of(self.largest.shrunk(size))._replace(numbers=numbers)

    def _of(self, largest: FiducialSight | LensSight) -> "SizedSight":
        return self._replace(largest=largest, reach=largest.reach)


def sized_sight(sights: Sequence[FiducialSight | LensSight]) -> SizedSight:
    """The sight of K tags, given that of each by itself."""
    largest = max(sights, key=lambda sight: half_edge(sight))
    return SizedSight(largest, np.ascontiguousarray(np.transpose([_numbers(sight) for sight in sights])), largest.reach)


def _numbers(sight: FiducialSight | LensSight) -> list[float]:
    flat, pinholes = (sight.flat, sight.pinholes) if isinstance(sight, LensSight) else (sight, ())
    areas = [pinhole.area for pinhole in pinholes] or [0.0, 0.0]
    return [flat.half, flat.plate, flat.area, flat.sharp, flat.blurred, *areas]


@sized.register(SizedSight)
def _sized(sight, k):  # type: ignore[no-untyped-def]
    return _with_numbers(sight.largest, sight.numbers, k)


@dispatched
def _with_numbers(sight, numbers, k):  # type: ignore[no-untyped-def]
    """The sight with column k of the numbers in place of its own; in Python also with all, as arrays `(K,)`."""


@_with_numbers.register(FiducialSight)
def _flat_with_numbers(sight, numbers, k):  # type: ignore[no-untyped-def]
    return _flat(sight, numbers, k, AREA)


@inlined
def _flat(sight, numbers, k, area):  # type: ignore[no-untyped-def]
    return FiducialSight(
        sight.outer_cosine, sight.inset, sight.reach, sight.facing, numbers[HALF, k], numbers[PLATE, k], sight.level,
        sight.left, sight.right, sight.top, sight.bottom, sight.focal_u, sight.focal_v, numbers[area, k],
        numbers[SHARP, k], numbers[BLURRED, k], sight.defocus, sight.focus, sight.in_focus,
    )  # fmt: skip


@_with_numbers.register(LensSight)
def _lens_with_numbers(sight, numbers, k):  # type: ignore[no-untyped-def]
    return LensSight(
        _with_numbers(sight.flat, numbers, k), sight.lens, sight.reach, sight.inset, sight.cosine, sight.shallowest,
        sight.least, sight.most, sight.least_area, sight.most_area, sight.stretch, sight.highest, sight.rough,
        sight.off, _pinholes(sight.lens, sight.pinholes, numbers, k),
    )  # fmt: skip


@overridable
def _pinholes(lens, pinholes, numbers, k):  # type: ignore[no-untyped-def]
    return _flat(pinholes[0], numbers, k, SHORT_AREA), _flat(pinholes[1], numbers, k, LONG_AREA)


@_pinholes.register(Equidistant)
def _no_pinholes(lens, pinholes, numbers, k):  # type: ignore[no-untyped-def]
    return pinholes


@half_edge.register(SizedSight)
def _half_edge(sight):  # type: ignore[no-untyped-def]
    return half_edge(sight.largest)


@pixel_density.register(SizedSight)
def _pixel_density(sight, x, y, z, axes, a):  # type: ignore[no-untyped-def]
    return pixel_density(sight.largest, x, y, z, axes, a)
