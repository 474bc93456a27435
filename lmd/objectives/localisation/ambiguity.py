"""Which of its two poses a single tag has: the planar ambiguity, and when the image tells the two apart.

A square of edge s at a distance d that is large for it looks nearly the same when its normal is mirrored about the line
of sight: the two solutions of IPPE. With unit vectors t and u along its right and up, and b to its centre, let
p = t . b and q = u . b; p^2 + q^2 is the squared sine of the incidence. To the leading order in s / d, shifts, turns
and foreshortening of the mirrored pose take up all differences of the two images but one: perspective, which tells the
nearer edge, moves the corners at the ends of one diagonal one way and those of the other the other way. It leaves the
squared residual

    S = (f s^2 / d^2)^2 (p^2 + q^2 - 4 p^2 q^2)

over the eight coordinates. A solver takes the pose that fits better. With noise of sigma on each coordinate that is the
mirrored one with the probability

    P = Q(sqrt(S) / (2 sigma)),    Q(x) the share of the standard normal distribution above x.

The poses are told apart if P is at most 1 - `CONFIDENCE`. Away from the middle of the image S grows with
`pixel_density`, as the information does. docs/results/ambiguity.md has what P is off by.

Two tags or more count as told apart: what mirrors one does not fit the other. `rig_ambiguity` has this of a rig.
"""

from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from lmd.core.compiled import inlined
from lmd.core.dispatch import overridable
from lmd.geometry.squares import upright_sides
from lmd.objectives.localisation.information import PosePrecision, Precision, SizedPrecision, meets
from lmd.scene.criteria import TOLERANCE

CONFIDENCE = 0.99  # that the better pose is the right one
# What a view needs: a tag that covers it adds 1, and S over what S must be. So two tags suffice, or one that tells.
ENOUGH = 2.0
# A tag that tells adds no more than this where the camera looks at it, which keeps sums small.
MOST = 16.0


class ResolvedPrecision(NamedTuple):
    """The same as another precision, of views whose pose is not mistaken for its mirrored one.

    of: the other; half, share, position: see there; square: what S must be in units of f^2.
    """

    of: Precision | PosePrecision
    half: float
    share: float
    position: float
    square: float

    @property
    def asks(self) -> bool:
        """See `Precision.asks`."""
        return self.of.asks


def resolved(asked: Precision | PosePrecision, scale: float) -> ResolvedPrecision:
    """The precision `asked` of views that are not ambiguous; scale: `information.deviation_per_variance`."""
    least = 2.0 * NormalDist().inv_cdf(CONFIDENCE) * scale
    return ResolvedPrecision(asked, asked.half, asked.share, asked.position, least**2 * (1.0 - TOLERANCE))


@overridable
def asks_apart(precision):
    """Whether `precision` asks that two poses of a single tag are told apart."""
    return False


@asks_apart.register(ResolvedPrecision)
def _asks_apart(precision):
    return True


@asks_apart.register(SizedPrecision)
def _asks_apart_of(precision):
    return asks_apart(precision.of)


@overridable
def square_of(precision):
    """What S must be in units of f^2."""
    return 0.0


@square_of.register(ResolvedPrecision)
def _square_of(precision):
    return precision.square


@square_of.register(SizedPrecision)
def _square_of_other(precision):
    return square_of(precision.of)


@inlined
def mirrored_square(x, y, z, rx, ry, rz, ux, uy, uz):
    """S of a tag times its distance cubed, in units of f^2; arguments as in `information.moments`."""
    squared = x * x + y * y + z * z
    along, above = x * rx + y * ry + z * rz, x * ux + y * uy + z * uz
    p, q = along * along / squared, above * above / squared  # times half the edge, squared
    return 16.0 * ((rx * rx + ry * ry + rz * rz) * (p + q) - 4.0 * (p * q)) / np.sqrt(squared)


@inlined
def telling(x, y, z, rx, ry, rz, ux, uy, uz, square):
    """S over what it must be, times the distance cubed."""
    squared = x * x + y * y + z * z
    told = mirrored_square(x, y, z, rx, ry, rz, ux, uy, uz) / square
    return np.minimum(told, MOST * (squared * np.sqrt(squared)))


@overridable
def told_apart(precision, half, x, y, z, nx, ny, nz):
    """What a landmark with half an edge adds to the last of a view's numbers, before `share_of`."""
    return 0.0


@told_apart.register(ResolvedPrecision)
def _told_apart(precision, half, x, y, z, nx, ny, nz):
    rx, ry, rz, ux, uy, uz = upright_sides(half, nx, ny, nz)
    return telling(x, y, z, rx, ry, rz, ux, uy, uz, precision.square)


@told_apart.register(SizedPrecision)
def _told_apart_of(precision, half, x, y, z, nx, ny, nz):
    return told_apart(precision.of, half, x, y, z, nx, ny, nz)


@overridable
def count_tag(precision, sums, v, factor):
    """Count a landmark that covers view v of `sums` `(V, WIDTH)` among the last number; -1 takes it away."""


@count_tag.register(ResolvedPrecision)
def _count_tag(precision, sums, v, factor):
    sums[v, sums.shape[1] - 1] += factor


@count_tag.register(SizedPrecision)
def _count_tag_of(precision, sums, v, factor):
    count_tag(precision.of, sums, v, factor)


@overridable
def tells(precision, told):
    """Whether views with that last number have one pose, as far as `precision` asks."""
    return True


@tells.register(ResolvedPrecision)
def _tells(precision, told):
    return told >= ENOUGH


@tells.register(SizedPrecision)
def _tells_of(precision, told):
    return tells(precision.of, told)


@meets.register(ResolvedPrecision)
def _meets_other(
    precision, axx, axy, axz, ayy, ayz, azz, gx, gy, gz, cxx, cxy, cxz, cyy, cyz, czz
):  # fmt: skip
    return meets(precision.of, axx, axy, axz, ayy, ayz, azz, gx, gy, gz, cxx, cxy, cxz, cyy, cyz, czz)
