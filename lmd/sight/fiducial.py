"""When a real detector sees a fiducial tag: its pitch, its size in the image, its corners, and plates in the way.

Fitted to what ArUco and AprilTag found in renderings of some 60,000 single tags: it predicts them in 95 to 96 % of
cases, and the probability of seeing at least n tags in whole rooms to 0.02. A tag is seen if

- it faces the camera at an incidence of at most `incidence`;
- its pitch, the pixels a module has where it is shortest, is at least sqrt(pitch^2 + (blur sigma)^2) with `pitch` and
  `blur` of the detector and sigma^2 = psf_sigma^2 + (c / 4)^2 + motion_blur^2 / 12, c the diameter of the thin lens's
  disc at the depth of its centre;
- the square of the same area in the image has an edge of at least `edge` pixels;
- the corners of its black square lie in the rectangular image, at least `margin` pixels from its border;
- no other plate covers its centre or a corner of its black square. Plates are squares of paper, quiet zone included.

Let (u, v, w) be the tag's centre in the camera's frame and t, s its right and up there. Metres in its plane become
pixels by J, whose columns are, for t and likewise for s, (f_u (t_u - t_w u / w) / w, f_v (t_v - t_w v / w) / w). The
smaller eigenvalue of J^T J is at least T if 2 T <= |J|^2 and T^2 - |J|^2 T + det(J)^2 >= 0, and
|det J| = f_u f_v |n . d| / w^3.

A corner is within a border if it is in a half-space, so the tag is if its farthest corner is.

All tags hang upright (`lmd.tag.upright`). The camera's lens must not distort: `Camera` has no such coefficients.

Shapes: A orientations, K tags. Lengths are metres, frames world unless said otherwise.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from lmd.camera import MM_PER_M, Camera
from lmd.checks import BoolArray, FloatArray, InputError, choice, real
from lmd.sight.criteria import TOLERANCE
from lmd.sight.fiducial_sight import FiducialSight
from lmd.sight.paper import dot
from lmd.tag import LEVEL, Tag, upright

# Tags at least this far away are spared the exact test if their centre is well inside the image, metres.
FAR = 1.6


@dataclass(frozen=True)
class Limits:
    """What a detector needs.

    Args:
        pitch: least pixels a module without blur.
        blur: how many more for each pixel of blur, as a root of squares.
        edge: least edge of the square of the same area, pixels.
        incidence: greatest angle between the tag's normal and the direction to the camera, degrees.
        margin: from the border of the image, pixels.

    Raises:
        InputError: a value is out of range.
    """

    pitch: float
    blur: float
    edge: float
    incidence: float
    margin: float

    def __post_init__(self) -> None:
        for name in ("pitch", "blur", "edge", "margin"):
            object.__setattr__(self, name, real(name, getattr(self, name), low=0.0))
        object.__setattr__(self, "incidence", real("incidence", self.incidence, above=0.0, high=89.0))


# Fitted to renderings, by detector and the beginning of the family's name; accuracy on other renderings .961, .955,
# .954, .950. wpilib is AprilTag with the defaults of WPILib, whose least size of a cluster makes half of the tags of
# 6.6 pixels a module appear and 95 % of those of 7.4, whatever the blur.
LIMITS = {
    ("apriltag", "36h11"): Limits(0.8, 1.8, 10.0, 84.0, 0.0),
    ("apriltag_decimate2", "36h11"): Limits(1.8, 1.6, 16.0, 80.0, 0.0),
    ("aruco", "36h11"): Limits(0.8, 1.8, 14.0, 84.0, 3.0),
    ("aruco", "4x4"): Limits(0.8, 2.2, 14.0, 84.0, 3.0),
    ("wpilib", "36h11"): Limits(6.6, 0.0, 16.0, 80.0, 0.0),
}


def _limits(detector: str, family: str, given: Limits | Mapping[str, Any] | None) -> Limits:
    """The limits of a detector for a family, with what is given instead."""
    if isinstance(given, Limits):
        return given
    names, changes = [field.name for field in fields(Limits)], dict(given or {})
    for name in changes:
        choice("limits", name, names)
    known = LIMITS.get((detector, family.partition("_")[0]))
    try:
        if known is not None:
            return replace(known, **changes)
        if set(changes) == set(names):
            return Limits(**changes)
    except InputError as error:
        raise error.within("limits") from None
    measured = ", ".join(" with ".join(pair) for pair in LIMITS)
    raise InputError(
        f"detector {detector} was not measured with tags of family {family}, only {measured}; "
        f"limits must give {', '.join(names)}.",
        "detector",
    )


@dataclass(frozen=True)
class Fiducial:
    """What a detector sees of tags; a `lmd.sight.criteria.Criteria`.

    Args:
        tag: what hangs at each landmark.
        detector: `aruco`, `apriltag`, `apriltag_decimate2` or `wpilib`, whose measured limits hold (`LIMITS`).
        limits: what differs from these; all of them for a detector or a family that was not measured.
        psf_sigma: standard deviation of the sharpest image of a point, pixels.
        motion_blur: length of the smear of a point while the shutter is open, pixels.

    Raises:
        InputError: the tag is a point, the detector's limits are not known, or a value is out of range.
    """

    tag: Tag
    detector: str = "aruco"
    limits: Limits | Mapping[str, Any] | None = None
    psf_sigma: float = 0.5
    motion_blur: float = 0.0

    needs_roll = True  # see `Criteria.needs_roll`: the image is a rectangle

    def __post_init__(self) -> None:
        if self.tag.is_point:
            raise InputError("tag must have an edge, in metres: what a detector sees depends on its size.")
        object.__setattr__(self, "limits", _limits(self.detector, self.tag.family, self.limits))
        object.__setattr__(self, "psf_sigma", real("psf_sigma", self.psf_sigma, low=0.0))
        object.__setattr__(self, "motion_blur", real("motion_blur", self.motion_blur, low=0.0))

    @property
    def spacing(self) -> float:
        """See `Criteria.spacing`: plates side by side."""
        return self.tag.paper_edge

    def sight(self, camera: Camera) -> FiducialSight:
        """See `Criteria.sight`."""
        limits, tag = _limits(self.detector, self.tag.family, self.limits), self.tag
        margin, (centre_u, centre_v), (focal_u, focal_v) = limits.margin, camera.principal_point, camera.focal_pixels
        left, right = (centre_u - margin) / focal_u, (camera.image_width - margin - centre_u) / focal_u
        top, bottom = (centre_v - margin) / focal_v, (camera.image_height - margin - centre_v) / focal_v
        # c / 4 = |defocus - focus / depth|, see `lmd.render.optics.blur_disc`.
        shape = camera.aperture * camera.focal_length / (4.0 * min(camera.pixel_width, camera.pixel_height))
        if math.isinf(camera.focus_distance):
            defocus, focus = 0.0, shape / MM_PER_M
        else:
            defocus = shape / (camera.focus_distance - camera.focal_length)
            focus = defocus * camera.focus_distance / MM_PER_M
        smooth = self.psf_sigma**2 + self.motion_blur**2 / 12.0
        wide = math.hypot(max(left, right), max(top, bottom))
        return FiducialSight(
            outer_cosine=(1.0 - TOLERANCE) / math.hypot(1.0, wide),
            inset=math.asin(min(1.0, 1.5 * tag.size / 2.0 / FAR)),
            reach=(tag.paper_edge + tag.size) ** 2 / 2.0 * (1.0 + TOLERANCE),
            facing=math.cos(math.radians(limits.incidence)) - TOLERANCE,
            half=tag.size / 2.0,
            plate=tag.paper_edge / 2.0 * (1.0 + TOLERANCE),
            level=LEVEL,
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

    def covered(
        self, camera: Camera, position: FloatArray, axes: FloatArray, landmarks: FloatArray, normals: FloatArray
    ) -> BoolArray:
        """See `Criteria.covered`."""
        sight, offset = self.sight(camera), landmarks - position
        seen = ~hidden_by_others(sight, offset, normals) & faces(sight, offset, normals)
        axis, right = axes[:, None, :3], axes[:, None, 3:]
        frame = np.stack([right, _cross(axis, right), axis])  # (3, A, 1, 3)
        centre, *sides = (dot(frame, vectors) for vectors in (offset, *upright(normals)))  # (3, A, K) each
        return in_rectangle(sight, centre, sides) & resolved(sight, centre, sides, offset, normals) & seen


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """a x b over the last axis, term by term."""
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def faces(sight: FiducialSight, offset: FloatArray, normals: FloatArray) -> BoolArray:
    """Whether the incidence is small enough, `(K,)`: -n . d >= cos(incidence) |d|."""
    return np.asarray(-dot(normals, offset) >= sight.facing * np.sqrt(dot(offset, offset)))


def in_rectangle(sight: FiducialSight, centre: FloatArray, sides: list[FloatArray]) -> BoolArray:
    """Whether the four corners are in front of the camera and within the borders, `(A, K)`.

    Args:
        sight: the borders.
        centre: (u, v, w) of the centre in the camera's frame, `(3, A, K)`.
        sides: the same of the tag's right and up, unit vectors.
    """
    (u, v, w), half, ((tu, tv, tw), (su, sv, sw)) = centre, sight.half, sides
    inside = half * (abs(tw) + abs(sw)) < w
    inside &= u + half * (abs(tu - sight.right * tw) + abs(su - sight.right * sw)) <= sight.right * w
    inside &= half * (abs(tu + sight.left * tw) + abs(su + sight.left * sw)) - u <= sight.left * w
    inside &= v + half * (abs(tv - sight.bottom * tw) + abs(sv - sight.bottom * sw)) <= sight.bottom * w
    inside &= half * (abs(tv + sight.top * tw) + abs(sv + sight.top * sw)) - v <= sight.top * w
    return np.asarray(inside)


def resolved(
    sight: FiducialSight, centre: FloatArray, sides: list[FloatArray], offset: FloatArray, normals: FloatArray
) -> BoolArray:
    """Whether pitch and area suffice, `(A, K)`; the arguments are those of `in_rectangle` and `faces`."""
    (u, v, w), ((tu, tv, tw), (su, sv, sw)) = centre, sides
    with np.errstate(all="ignore"):  # a tag beside the camera is not resolved, whatever the numbers say
        per = 1.0 / w
        fu, fv, at_u, at_v = sight.focal_u * per, sight.focal_v * per, u * per, v * per
        one, two, three, four = tu - at_u * tw, su - at_u * sw, tv - at_v * tw, sv - at_v * sw
        square = fu * fu * (one * one + two * two) + fv * fv * (three * three + four * four)
        determinant = fu * fv * per * abs(dot(normals, offset))
        blur = sight.defocus - sight.focus * per
        least = sight.sharp + sight.blurred * (blur * blur)
        enough = (2.0 * least <= square) & (determinant >= sight.area)
        return np.asarray(enough & (least * least + determinant * determinant >= square * least))


def hidden_by_others(sight: FiducialSight, offset: FloatArray, normals: FloatArray) -> BoolArray:
    """Whether the line of sight to the centre or a corner of a tag passes through another plate in front of it, `(K,)`.

    Nothing hides what is at most a nanometre (`TOLERANCE`) behind the plane of the plate: plates on one wall never do.
    """
    right, up = upright(normals)
    r, s = sight.half * right, sight.half * up
    points = np.stack([offset, *(offset + way for way in (r + s, -(r + s), r - s, -(r - s)))])[:, :, None]  # of B
    height = -dot(normals, offset)  # of the camera above the plane of A, (K,)
    side = dot(normals, points) + height  # and of each point of B, (5, K, K): B first
    crosses = ((height > 0.0) & (side < -TOLERANCE)) | ((height < 0.0) & (side > TOLERANCE))
    with np.errstate(all="ignore"):  # where the line does not cross the plane, share is anything
        share = height / (height - side)
        at = share[..., None] * points - offset
        within = (abs(dot(right, at)) <= sight.plate) & (abs(dot(up, at)) <= sight.plate)
    hides = np.asarray(np.any(crosses & within, axis=0))
    hides[np.arange(len(offset)), np.arange(len(offset))] = False
    return np.asarray(hides.any(axis=1))
