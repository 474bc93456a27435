"""The paper's four criteria: resolution, field of view, focus and occlusion (Sec. III).

The NumPy reference has one function per equation; `PaperSight` is the model of sight for compiled code. Decisions are
closed inequalities with the shared `TOLERANCE`, and sums are written out term by term. Compiled code repeats the
operations in their order, so its counts are identical even for a landmark exactly on a boundary.

Let z be the depth along the optical axis of a landmark at distance d. The landmark is covered, unless occluded, iff

    max(min_cosine d, min_depth) <= z <= max_depth,

where `min_cosine` follows from the field of view, `min_depth` from focus, and `max_depth` from focus and resolution.

Shapes: A orientations, K landmarks. Lengths are in metres, angles in radians, vectors in the world frame.
Source: Lei et al., "Optimization of Directional Landmark Deployment for Visual Observer on SE(3)".
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, Checked, FloatArray, NotNegative, Positive, choice
from lmd.geometry.camera import Camera
from lmd.geometry.vectors import Vector, cross3, dot3
from lmd.scene.criteria import TOLERANCE, from_around, from_position, hide, in_cone, in_image, in_view


class PaperSight(NamedTuple):
    """The paper's criteria compiled for one camera: bounds on the depth; a `lmd.scene.criteria.SightModel`.

    The bounds include tolerances for rounding.
    """

    min_cosine: float
    """Cosine of the half-angle of the cone of view."""
    min_depth: float
    """Least depth, metres."""
    max_depth: float
    """Greatest depth, metres."""
    reach: float
    """Square of the landmarks' virtual diameter nu (`Visibility.nu`), m^2; negative if occlusion by other landmarks is
    not tested.
    """
    whole_line: bool
    """True if a landmark is also hidden by landmarks behind the camera, and by landmarks that are farther away than
    itself.
    """

    @property
    def outer_cosine(self) -> float:
        """See `SightModel.outer_cosine`."""
        return self.min_cosine - TOLERANCE

    @property
    def inset(self) -> float:
        """See `SightModel.inset`; 0, as a landmark is a point."""
        return 0.0

    @property
    def horizon(self) -> float:
        """See `SightModel.horizon`; infinite for `whole_line`, as a landmark at any distance may hide another
        landmark.
        """
        if self.min_cosine <= 0.0 or (self.whole_line and self.reach >= 0.0):
            return math.inf
        return (self.max_depth / self.min_cosine + math.sqrt(max(self.reach, 0.0))) * (1.0 + 2.0 * TOLERANCE)

    def unhidden(self) -> "PaperSight":
        """See `SightModel.unhidden`."""
        return self._replace(reach=-1.0)

    def among(self, low: FloatArray, high: FloatArray, landmarks: FloatArray, normals: FloatArray) -> "PaperSight":
        """See `SightModel.among`. The result is always the model itself."""
        return self

    def shrunk(self, size: float) -> "PaperSight":
        """See `SightModel.shrunk`."""
        return self._replace(reach=self.reach * size**2)


@from_position.register(PaperSight)
def _from_position(sight: Any, offset: Vector, normal: Vector, slack: float) -> Any:
    distance = math.sqrt(dot3(offset, offset))
    nearest = distance - slack
    low = max(nearest * sight.min_cosine, sight.min_depth) - slack
    in_depth = (nearest * sight.min_cosine <= sight.max_depth) & (
        (distance + slack) * (1.0 + TOLERANCE) >= sight.min_depth
    )
    facing = -dot3(normal, offset) > TOLERANCE * nearest
    limited = (distance * sight.min_cosine < sight.min_depth) | (distance * (1.0 + TOLERANCE) > sight.max_depth)
    return in_depth & facing, low, sight.max_depth, sight.max_depth if limited else math.inf


@from_around.register(PaperSight)
def _from_around(sight: Any, offset: Vector, normal: Vector, radius: float) -> Any:
    distance, along = math.sqrt(dot3(offset, offset)), -dot3(normal, offset)
    nearest, farthest = max(distance - radius, 0.0), (distance + radius) * (1.0 + TOLERANCE)
    least = min(nearest * sight.min_cosine, farthest * sight.min_cosine)
    reached = (least <= sight.max_depth) & (farthest >= sight.min_depth) & (along + radius > 0.0)
    start = sight.min_depth if least < sight.min_depth else -math.inf
    sure = sight.max_depth if farthest > sight.max_depth else math.inf
    facing = along - radius > TOLERANCE * farthest
    return reached, sight.max_depth, start, sure if facing else -math.inf


@in_image.register(PaperSight)
def _in_image(sight: Any, offset: Vector, normal: Vector, low: float, slack: float, axis: Vector, right: Vector) -> Any:
    depth = dot3(axis, offset)
    return (depth >= low) & (depth <= sight.max_depth + slack)


@in_view.register(PaperSight)
def _in_view(sight: Any, way: Vector, sine: float, cosine: float, axis: Vector, right: Vector) -> Any:
    return in_cone(sight.min_cosine + (TOLERANCE if sine > 0.0 else -TOLERANCE), way, sine, cosine, axis)


@hide.register(PaperSight)
def _hide(sight: Any, a: Vector, aa: float, b: Vector, bb: float, u: Vector, v: Vector) -> Any:
    c = cross3(a, b)
    cross = dot3(c, c)
    one, two = cross <= sight.reach * bb, cross <= sight.reach * aa
    if not sight.whole_line:
        in_front = dot3(b, a) > 0.0
        one = one & in_front & (aa <= bb * (1.0 + TOLERANCE))
        two = two & in_front & (bb <= aa * (1.0 + TOLERANCE))
    return one, two


OCCLUSION_MODES = ("paper", "line_of_sight", "none")


@dataclass(frozen=True)
class Visibility(Checked):
    """Thresholds of the paper's criteria; a `lmd.scene.criteria.Criteria`.

    Args:
        thold: coverage-strength threshold, pixel/mm.
        nu: virtual diameter nu_k of a landmark, metres; a landmark closer than nu to the line of sight to another
            landmark hides this other landmark. 0 switches the test off, so an optimiser may put several landmarks on
            one point.
        occlusion: `paper` tests the distance to the whole line through camera and landmark, as printed.
            `line_of_sight` tests only landmarks in front of the camera that are at most as far away as the hidden
            landmark. `none` ignores other landmarks. All modes require the landmark to face the camera.
        circle_of_confusion: permissible diameter delta, pixels.

    Raises:
        InputError: a value is out of range.
    """

    thold: Positive
    nu: NotNegative = 0.05
    occlusion: Annotated[str, partial(choice, options=OCCLUSION_MODES)] = "paper"
    circle_of_confusion: Positive = 4.0

    needs_roll = False  # see `Criteria.needs_roll`: the cone of view is round

    @property
    def tests_other_landmarks(self) -> bool:
        """True if one landmark can hide another."""
        return self.occlusion != "none" and self.nu > 0.0

    @property
    def spacing(self) -> float:
        """See `Criteria.spacing`; the virtual diameter."""
        return self.nu

    def covered(
        self, camera: Camera, position: FloatArray, axes: FloatArray, landmarks: FloatArray, normals: FloatArray
    ) -> BoolArray:
        """See `Criteria.covered`: True if C^R C^FOV C^F C^O >= thold.

        For landmark k, the orientations with True are the coverage cap S_k^C(p) (Definition 1).
        """
        met = self.verdicts(camera, position, axes, landmarks, normals)
        return np.asarray(np.logical_and.reduce(list(met.values())))

    def verdicts(
        self, camera: Camera, position: FloatArray, axes: FloatArray, landmarks: FloatArray, normals: FloatArray
    ) -> dict[str, BoolArray]:
        """Masks `(A, K)` of the landmarks that meet each criterion, keyed by the criterion's name.

        The camera is at `position` `(3,)`, metres, with the orientations `axes` `(A, 6)`, of which only the optical
        axes are used. The landmarks have the positions `landmarks` `(K, 3)`, metres, and the unit normals `normals`
        `(K, 3)`.
        """
        offset = landmarks - position
        distance = np.sqrt(dot(offset, offset))
        depth = dot(axes[:, None, :], offset[None, :, :])
        everywhere = np.ones_like(depth, dtype=np.bool_)
        return {
            "resolution": resolution(camera, depth) >= self.thold * (1.0 - TOLERANCE),
            "field_of_view": field_of_view(camera, depth, distance[None, :]),
            "focus": focus(camera, self.circle_of_confusion, depth),
            "facing": everywhere & ~faces_away(offset, distance, normals),
            "hiding": everywhere & ~hidden_by_others(offset, self),
        }

    def limits_for(self, camera: Camera) -> dict[str, str]:
        """Limit of each criterion for a camera, in a few words, keyed by the criterion's name."""
        near, far = camera.depth_of_field(self.circle_of_confusion)
        in_focus = "any depth ahead: no aperture" if camera.is_pinhole else f"depth from {near:.3g} to {far:.3g} m"
        half_angle = math.degrees(camera.cone_half_angle)
        hiding = f"no other landmark within nu = {self.nu:g} m of the line of sight"
        return {
            "resolution": f"depth up to {camera.resolution_depth(self.thold):.3g} m (thold = {self.thold:g} pixel/mm)",
            "field_of_view": f"within {half_angle:.3g} degrees of the optical axis",
            "focus": in_focus,
            "facing": "incidence below 90 degrees",
            "hiding": hiding if self.tests_other_landmarks else "other landmarks hide nothing",
        }

    def sight(self, camera: Camera) -> PaperSight:
        """See `Criteria.sight`; `max_depth` is the largest float64 number that passes both focus and resolution."""
        near, far = camera.depth_of_field(self.circle_of_confusion)
        at_one_metre, thold = camera.resolution_at_one_metre, self.thold * (1.0 - TOLERANCE)
        depth = at_one_metre / thold
        # The quotient may round to either side of the greatest depth that passes `strength >= threshold`; single steps
        # lead to that depth, so the bound equals the reference bit for bit.
        while at_one_metre / depth < thold:
            depth = math.nextafter(depth, 0.0)
        while at_one_metre / (further := math.nextafter(depth, math.inf)) >= thold:
            depth = further
        return PaperSight(
            min_cosine=math.cos(camera.cone_half_angle) - TOLERANCE,
            min_depth=near * (1.0 - TOLERANCE),
            max_depth=min(depth, far * (1.0 + TOLERANCE)),
            reach=(self.nu * (1.0 + TOLERANCE)) ** 2 if self.tests_other_landmarks else -1.0,
            whole_line=self.occlusion == "paper",
        )


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Inner product over the last axis, summed from left to right."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def resolution(camera: Camera, depth: FloatArray) -> FloatArray:
    """Resolution C^R = f d_s / ((d_s - f) z max(s_u, s_v)) at the depth z, pixel/mm (Eq. C_k^R).

    The camera has the focal length f, the focus distance d_s and the pixel sizes s_u and s_v.

    Args:
        camera: intrinsics.
        depth: z^c, any shape, metres; the resolution behind the camera is 0.
    """
    positive = np.where(depth > 0.0, depth, np.inf)
    with np.errstate(over="ignore"):  # a tiny depth has infinite resolution
        return np.asarray(camera.resolution_at_one_metre / positive)


def field_of_view(camera: Camera, depth: FloatArray, distance: FloatArray) -> BoolArray:
    """Mask C^FOV of the landmarks in the cone of view: z > 0 and sqrt(x^2 + y^2) / z <= tan(min(phi)) (Eq. C_k^FOV).

    The landmark is at (x, y, z) in the camera frame, and min(phi) is the cone's half-angle. The test has the form z >=
    |s| cos(min(phi)), which describes the same cone. The test needs no division, and neither x nor y, which depend on
    the camera's roll.

    Args:
        camera: intrinsics.
        depth: z^c, metres.
        distance: |s^c|, metres, shape of `depth`.
    """
    return np.asarray(depth >= distance * (math.cos(camera.cone_half_angle) - TOLERANCE)) & (depth > 0.0)


def focus(camera: Camera, circle_of_confusion: float, depth: FloatArray) -> BoolArray:
    """Mask C^F of the depths z in focus, d_n <= z <= d_f (Eq. C_k^F), with the shape of `depth`. The limits d_n and d_f
    of the depth of field follow from the permissible `circle_of_confusion`, pixels.
    """
    near, far = camera.depth_of_field(circle_of_confusion)
    return np.asarray((depth >= near * (1.0 - TOLERANCE)) & (depth <= far * (1.0 + TOLERANCE)))


def faces_away(offset: FloatArray, distance: FloatArray, normals: FloatArray) -> BoolArray:
    """Mask `(K,)` of the landmarks with zeta >= pi/2, whose front face the camera cannot see (Eq. occlusion1).

    The incidence angle zeta has cos(zeta) = n . (p - s) / |p - s|, which is compared with 0.

    Args:
        offset: s_k - p, metres, `(K, 3)`.
        distance: |s_k - p|, metres, `(K,)`.
        normals: n_k, unit vectors, `(K, 3)`.
    """
    return np.asarray(-dot(normals, offset) <= TOLERANCE * distance)


def hidden_by_others(offset: FloatArray, visibility: Visibility) -> BoolArray:
    """Mask `(K,)` of the landmarks with another landmark within nu of the line of sight (Eq. occlusion2).

    The paper's |s_j - p| sqrt(1 - cos^2) is the distance from s_j to the line through p and s_k; cos belongs to the
    angle between d_j and d_k. The distance is computed as |d_j x d_k| / |d_k|, which stays accurate for nearly
    collinear landmarks.

    Args:
        offset: d = s - p, metres, `(K, 3)`.
        visibility: criteria with the virtual diameter nu and the occlusion mode.
    """
    count = len(offset)
    if not visibility.tests_other_landmarks:
        return np.zeros(count, dtype=bool)
    looked_at, other = offset[:, None, :], offset[None, :, :]
    cx = other[..., 1] * looked_at[..., 2] - other[..., 2] * looked_at[..., 1]
    cy = other[..., 2] * looked_at[..., 0] - other[..., 0] * looked_at[..., 2]
    cz = other[..., 0] * looked_at[..., 1] - other[..., 1] * looked_at[..., 0]
    squared = dot(offset, offset)
    reach = (visibility.nu * (1.0 + TOLERANCE)) ** 2
    hides = cx * cx + cy * cy + cz * cz <= reach * squared[:, None]
    if visibility.occlusion == "line_of_sight":
        hides &= dot(looked_at, other) > 0.0
        hides &= squared[None, :] <= squared[:, None] * (1.0 + TOLERANCE)
    hides[np.arange(count), np.arange(count)] = False
    return np.asarray(hides.any(axis=1))
