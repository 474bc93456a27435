"""Visibility model of a tag detector: incidence angle, pitch, image area, field of view and occlusion.

The limits are fitted to the detections of ArUco and AprilTag in renderings of about 60,000 single tags. The model
predicts 95 to 96 % of these detections; its probability of seeing at least n tags, tested in whole rooms, is accurate
to within 0.02. A tag is seen under five conditions:

- The incidence angle is at most `incidence`.
- The pitch is at least sqrt(pitch^2 + (blur sigma)^2), with the limits `pitch` and `blur` of the detector. The pitch is
  the least image length of a module (cell of the tag's pattern) over all directions in the tag's plane. Here sigma^2 =
  psf_sigma^2 + (c / 4)^2 + motion_blur^2 / 12. At the depth of the tag's centre, the circle of confusion of a thin lens
  has the diameter c.
- The square root of the image area is at least `edge` pixels.
- The corners of the black square lie in the rectangular image, at least `margin` pixels from the border.
- No footprint of another tag covers the centre or a corner of the black square. The footprint of a tag is the black
  square with the quiet zone around it.

Let (u, v, w) be the tag's centre in the camera frame, and t, s the tag's unit vectors to the right and up. The Jacobian
J maps metres in the plane of the tag to pixels. The column for t is (f_u (t_u - t_w u / w) / w, f_v (t_v - t_w v / w) /
w). The column for s has s_u, s_v and s_w in place of t_u, t_v and t_w. The smaller eigenvalue of J^T J is at least a
number T if 2 T <= |J|^2 and T^2 - |J|^2 T + det(J)^2 >= 0, with the Frobenius norm |J|. Moreover |det J| =
f_u f_v |n . d| / w^3, with the unit normal n of the tag and its offset d from the camera.

Each border of a pinhole image bounds a half-space in the camera frame, so the corner farthest out decides. With lens
distortion, the centre and each corner are projected one by one and must lie within `Camera.widest_angle` of the axis,
and J is the Jacobian of the lens times (t, s). For a fisheye, the blur is computed at the distance of the centre, as
the depth is 0 at 90 degrees from the axis.

All tags hang upright (`lmd.geometry.squares.upright`).

Shapes: A orientations, K tags. Lengths are in metres, vectors in the world frame unless said otherwise.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from lmd.core.checks import BoolArray, Checked, FloatArray, InputError, NotNegative
from lmd.geometry.camera import MM_PER_M, Camera
from lmd.geometry.lens import EQUIDISTANT, Lens, approximation, ceiling
from lmd.geometry.se3 import cross
from lmd.geometry.squares import VERTICAL_TOLERANCE, upright
from lmd.scene.criteria import TOLERANCE
from lmd.scene.tag import Tag
from lmd.sight.models.fiducial_reference import (
    faces,
    hidden_by_others,
    in_bent_rectangle,
    in_rectangle,
    resolved,
    resolved_by_lens,
)
from lmd.sight.models.fiducial_sight import FiducialSight, of_sizes
from lmd.sight.models.lens_sight import NEAR, LensSight, of_sizes_behind_lens
from lmd.sight.models.limits import Limits, limits_of
from lmd.sight.models.paper import dot

# Least distance at which tags with the centre well in view need no exact test of the corners, metres.
FAR = 1.6


@dataclass(frozen=True)
class Fiducial(Checked):
    """Criteria of a tag detector; a `lmd.scene.criteria.Criteria`.

    Args:
        tag: size and family of the tags.
        detector: name of a detector whose limits were measured (`aruco`, `apriltag`, `apriltag_decimate2`, `wpilib`),
            or the path of a file with limits, see `lmd.sight.models.limits`.
        limits: values that replace single limits; for a detector or a family that was not measured, `limits` must give
            all limits.
        psf_sigma: standard deviation of the point spread function in focus, pixels.
        motion_blur: path of an image point during the exposure, pixels.
        edges: edge length of the tag at each landmark, or one length for all, metres; None for the edge length of
            `tag`.

    Raises:
        InputError: the tag is a point, the detector's limits are not known, or a value is out of range.
    """

    tag: Tag
    detector: str = "aruco"
    limits: Limits | Mapping[str, Any] | None = None
    psf_sigma: NotNegative = 0.5
    motion_blur: NotNegative = 0.0
    edges: tuple[float, ...] | None = None

    needs_roll = True  # see `Criteria.needs_roll`: the image is a rectangle

    def _validate(self) -> None:
        if self.tag.is_point:
            raise InputError("tag must have an edge, in metres: what a detector sees depends on the tag's size.")
        if not isinstance(self.limits, Limits):
            object.__setattr__(self, "limits", limits_of(self.detector, self.tag.family, self.limits or {}))

    @property
    def spacing(self) -> float:
        """See `Criteria.spacing`: the edge length of a footprint."""
        return self.tag.paper_edge

    def sized(self, edges: tuple[float, ...]) -> "Fiducial":
        """Copy of the criteria for landmarks with the given edge lengths, metres."""
        return replace(self, edges=edges)

    def sight(self, camera: Camera) -> FiducialSight | LensSight:
        """See `Criteria.sight`."""
        if self.edges is None:
            return self._sight_of(self.tag, camera)
        each: dict[float, Any] = {
            edge: self._sight_of(replace(self.tag, edge=edge), camera) for edge in set(self.edges)
        }
        if len(each) == 1:
            return each[self.edges[0]]  # type: ignore[no-any-return] # a sight
        sights = [each[edge] for edge in self.edges]
        return of_sizes(sights) if camera.lens is None else of_sizes_behind_lens(sights)

    def _sight_of(self, tag: Tag, camera: Camera) -> FiducialSight | LensSight:
        """Compiled model of sight of a camera for a single size of tag, that of `tag`."""
        limits = self.limits
        assert isinstance(limits, Limits)
        margin, (centre_u, centre_v), (focal_u, focal_v) = limits.margin, camera.principal_point, camera.focal_pixels
        left, right = (centre_u - margin) / focal_u, (camera.image_width - margin - centre_u) / focal_u
        top, bottom = (centre_v - margin) / focal_v, (camera.image_height - margin - centre_v) / focal_v
        # c / 4 = |defocus - focus / depth|, see `lmd.geometry.projection.blur_disc`.
        shape = camera.aperture * camera.focal_length / (4.0 * min(camera.pixel_width, camera.pixel_height))
        if math.isinf(camera.focus_distance):
            defocus, focus = 0.0, shape / MM_PER_M
        else:
            defocus = shape / (camera.focus_distance - camera.focal_length)
            focus = defocus * camera.focus_distance / MM_PER_M
        smooth = self.psf_sigma**2 + self.motion_blur**2 / 12.0
        wide = math.hypot(max(left, right), max(top, bottom))
        flat = FiducialSight(
            outer_cosine=(1.0 - TOLERANCE) / math.hypot(1.0, wide),
            inset=math.asin(min(1.0, 1.5 * tag.picture_edge / 2.0 / FAR)),
            reach=(tag.paper_edge + tag.picture_edge) ** 2 / 2.0 * (1.0 + TOLERANCE),
            facing=math.cos(math.radians(limits.incidence)) - TOLERANCE,
            half=tag.picture_edge / 2.0,
            footprint=tag.paper_edge / 2.0 * (1.0 + TOLERANCE),
            level=VERTICAL_TOLERANCE,
            left=left + TOLERANCE,
            right=right + TOLERANCE,
            top=top + TOLERANCE,
            bottom=bottom + TOLERANCE,
            focal_u=float(focal_u),
            focal_v=float(focal_v),
            area=(limits.edge / tag.size) ** 2 * (1.0 - TOLERANCE),
            sharp=(limits.pitch**2 + limits.blur**2 * smooth) / tag.module**2 * (1.0 - TOLERANCE),
            blurred=(limits.blur / tag.module) ** 2 * (1.0 - TOLERANCE),
            defocus=defocus,
            focus=focus,
            in_focus=focus / defocus if defocus else 0.0,
        )
        return flat if camera.lens is None else _through(camera.lens, camera.widest_angle, flat)

    def covered(
        self, camera: Camera, position: FloatArray, axes: FloatArray, landmarks: FloatArray, normals: FloatArray
    ) -> BoolArray:
        """See `Criteria.covered`."""
        met = self.verdicts(camera, position, axes, landmarks, normals)
        return np.asarray(np.logical_and.reduce(list(met.values())))

    def verdicts(
        self, camera: Camera, position: FloatArray, axes: FloatArray, landmarks: FloatArray, normals: FloatArray
    ) -> dict[str, BoolArray]:
        """Masks `(A, K)` of the tags that meet each criterion, keyed by the criterion's name.

        The camera is at `position` `(3,)`, metres, with the orientations `axes` `(A, 6)`: unit vectors along the
        optical axis and to the right in the image. The tags have the centres `landmarks` `(K, 3)`, metres, and the unit
        normals `normals`.
        """
        sight, offset = self.sight(camera), landmarks - position
        flat = sight.flat if isinstance(sight, LensSight) else sight
        axis, right = axes[:, None, :3], axes[:, None, 3:]
        frame = np.stack([right, cross(axis, right), axis])  # (3, A, 1, 3)
        centre, *sides = (dot(frame, vectors) for vectors in (offset, *upright(normals)))  # (3, A, K) each
        if isinstance(sight, LensSight):
            inside, clear = in_bent_rectangle(sight, centre, sides), resolved_by_lens(sight, centre, sides)
        else:
            inside, clear = in_rectangle(sight, centre, sides), resolved(sight, centre, sides, offset, normals)
        everywhere = np.ones_like(inside)
        return {
            "resolution": clear,
            "field_of_view": inside,
            "facing": everywhere & faces(flat, offset, normals),
            "hiding": everywhere & ~hidden_by_others(flat, offset, normals),
        }

    def limits_for(self, camera: Camera) -> dict[str, str]:
        """Limit of each criterion for a camera, in a few words, keyed by the criterion's name."""
        limits, view = self.limits, camera.field_of_view
        assert isinstance(limits, Limits)
        across, down = math.degrees(view.left + view.right), math.degrees(view.top + view.bottom)
        return {
            "resolution": f"{limits.pitch:.3g} pixels a module, more where it is blurred, and an edge of "
            f"{limits.edge:.3g} pixels",
            "field_of_view": f"every corner in the image of {across:.3g} x {down:.3g} degrees, "
            f"{limits.margin:g} pixels from its border",
            "facing": f"incidence up to {limits.incidence:.3g} degrees",
            "hiding": "no other footprint before the centre or a corner",
        }


@lru_cache
def _through(lens: Lens, widest: float, flat: FiducialSight) -> LensSight:
    """Compiled model of sight for a lens with distortion.

    `flat` is the model without distortion, `widest` the greatest angle from the optical axis, rad.
    """
    bounds = lens.stretch(widest)
    # An arc between two directions in view leaves the cone of the widest angle only if that angle exceeds 90 degrees.
    around = widest if widest <= math.pi / 2.0 else min(widest + NEAR, math.pi)
    polynomial, image_error = approximation(lens, widest)
    low, high, area = min(flat.focal_u, flat.focal_v), max(flat.focal_u, flat.focal_v), flat.focal_u * flat.focal_v
    return LensSight(
        flat=flat,
        lens=lens.model_numbers,
        reach=flat.reach,
        inset=flat.inset,
        cosine=math.cos(widest) - TOLERANCE,
        min_depth_ratio=1.0 if lens.model == EQUIDISTANT else math.cos(widest),
        min_pitch=max(bounds.least, 0.0) * low,
        max_pitch=bounds.most * high,
        min_area=max(bounds.least_area, 0.0) * area,
        max_area=bounds.most_area * area,
        stretch=ceiling(lens, around),
        stretch_end=1.0 - math.cos(around),
        approximation=polynomial,
        image_error=image_error,
        pinholes=() if lens.model == EQUIDISTANT else _pinholes(lens, widest, flat),
    )


def _pinholes(lens: Lens, widest: float, flat: FiducialSight) -> tuple[FiducialSight, FiducialSight]:
    """Two cameras without distortion that bound the pitch and the area of a tag seen through the lens.

    At each depth, the first one gives lower bounds, the second one upper bounds.
    """
    rates = lens.stretch(widest, power=1)
    shorter = rates.least if min(rates.least, rates.least_area) > 0.0 else 0.0
    longer = max(rates.most, math.sqrt(rates.most_area))  # pitch^2 <= area

    def pinhole(rate: float, area: float) -> FiducialSight:
        return flat._replace(
            outer_cosine=math.cos(widest) * (1.0 - TOLERANCE),
            focal_u=rate * flat.focal_u,
            focal_v=rate * flat.focal_v,
            area=flat.area * rate * rate / area if rate else flat.area,
        )

    return pinhole(shorter, rates.least_area), pinhole(longer, rates.most_area)
