"""NumPy reference of each criterion of `lmd.sight.models.fiducial`.

Compiled code repeats its operations in their order, so the results are equal bit for bit.

Shapes: A orientations, K tags. Lengths are in metres, vectors in the world frame unless said otherwise.
"""

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.geometry.lens_models import depth_of, image_of, slope_of
from lmd.geometry.squares import upright
from lmd.scene.criteria import TOLERANCE
from lmd.sight.models.fiducial_sight import FiducialSight
from lmd.sight.models.lens_sight import LensSight
from lmd.sight.models.paper import dot


def faces(sight: FiducialSight, offset: FloatArray, normals: FloatArray) -> BoolArray:
    """Mask `(K,)` of the tags whose incidence angle is at most the limit: -n . d >= cos(limit) |d|. Here n is the unit
    normal of a tag (`normals` `(K, 3)`), and d its offset from the camera (`offset` `(K, 3)`, metres).
    """
    return np.asarray(-dot(normals, offset) >= sight.facing * np.sqrt(dot(offset, offset)))


def in_rectangle(sight: FiducialSight, centre: FloatArray, sides: list[FloatArray]) -> BoolArray:
    """Mask `(A, K)` of the tags with all corners in front of the camera and within the borders of the image.

    Args:
        sight: compiled model, with the borders of the image.
        centre: centres (u, v, w) in the camera frame, metres, `(3, A, K)`.
        sides: right and up vectors of the tags, unit vectors in the camera frame, `(3, A, K)` each.
    """
    (u, v, w), half, ((tu, tv, tw), (su, sv, sw)) = centre, sight.half, sides
    inside = half * (abs(tw) + abs(sw)) < w
    inside &= u + half * (abs(tu - sight.right * tw) + abs(su - sight.right * sw)) <= sight.right * w
    inside &= half * (abs(tu + sight.left * tw) + abs(su + sight.left * sw)) - u <= sight.left * w
    inside &= v + half * (abs(tv - sight.bottom * tw) + abs(sv - sight.bottom * sw)) <= sight.bottom * w
    inside &= half * (abs(tv + sight.top * tw) + abs(sv + sight.top * sw)) - v <= sight.top * w
    return np.asarray(inside)


def in_bent_rectangle(sight: LensSight, centre: FloatArray, sides: list[FloatArray]) -> BoolArray:
    """Mask `(A, K)` of the tags with centre and corners in the image, and within the widest angle of a lens with
    distortion.

    Args:
        sight: compiled model, with the lens and the borders of the image.
        centre: centres (u, v, w) of the tags in the camera frame, metres, `(3, A, K)`.
        sides: right and up vectors of the tags, unit vectors in the camera frame, `(3, A, K)` each.
    """
    right, up = sides
    inside, flat = np.ones(centre.shape[1:], dtype=np.bool_), sight.flat
    one, two = flat.half * (right + up), flat.half * (right - up)
    with np.errstate(all="ignore"):  # a corner beside the camera is outside; NaN compares as False
        for u, v, w in (centre, centre + one, centre - one, centre + two, centre - two):
            across, down = image_of(sight.lens, u, v, w)
            inside &= w >= sight.cosine * np.sqrt(u * u + v * v + w * w)
            inside &= (-flat.left <= across) & (across <= flat.right) & (-flat.top <= down) & (down <= flat.bottom)
    return inside


def resolved(
    sight: FiducialSight, centre: FloatArray, sides: list[FloatArray], offset: FloatArray, normals: FloatArray
) -> BoolArray:
    """Mask `(A, K)` of the tags whose pitch (least image length of a module) and image area suffice.

    Args:
        sight: compiled model, with the limits.
        centre: centres (u, v, w) of the tags in the camera frame, metres, `(3, A, K)`.
        sides: right and up vectors of the tags, unit vectors in the camera frame, `(3, A, K)` each.
        offset: offsets of the tags from the camera, world frame, metres, `(K, 3)`.
        normals: unit normals of the tags, world frame, `(K, 3)`.
    """
    (u, v, w), ((tu, tv, tw), (su, sv, sw)) = centre, sides
    with np.errstate(all="ignore"):  # a tag beside the camera is not resolved; NaN compares as False
        per = 1.0 / w
        fu, fv, at_u, at_v = sight.focal_u * per, sight.focal_v * per, u * per, v * per
        one, two, three, four = tu - at_u * tw, su - at_u * sw, tv - at_v * tw, sv - at_v * sw
        square = fu * fu * (one * one + two * two) + fv * fv * (three * three + four * four)
        return _suffices(sight, square, fu * fv * per * abs(dot(normals, offset)), per)


def resolved_by_lens(sight: LensSight, centre: FloatArray, sides: list[FloatArray]) -> BoolArray:
    """Mask `(A, K)` of the tags whose pitch and image area suffice, for a lens with distortion.

    Args:
        sight: compiled model, with the lens and the limits.
        centre: centres (u, v, w) of the tags in the camera frame, metres, `(3, A, K)`.
        sides: right and up vectors of the tags, unit vectors in the camera frame, `(3, A, K)` each.
    """
    (u, v, w), ((tu, tv, tw), (su, sv, sw)), flat = centre, sides, sight.flat
    with np.errstate(all="ignore"):
        xu, xv, xw, yu, yv, yw = slope_of(sight.lens, u, v, w)
        one, two = xu * tu + xv * tv + xw * tw, xu * su + xv * sv + xw * sw
        three, four = yu * tu + yv * tv + yw * tw, yu * su + yv * sv + yw * sw
        fu, fv = flat.focal_u, flat.focal_v
        square = fu * fu * (one * one + two * two) + fv * fv * (three * three + four * four)
        determinant = fu * fv * abs(one * four - two * three)
        return _suffices(flat, square, determinant, 1.0 / depth_of(sight.lens, u, v, w))


def _suffices(sight: FiducialSight, square: FloatArray, determinant: FloatArray, per: FloatArray) -> BoolArray:
    """Mask of the tags whose pitch and image area suffice, in the shape of the arguments.

    `square` is |J|_F^2 and `determinant` is |det J|, with the Jacobian J of `lmd.sight.models.fiducial`. `per` is the
    reciprocal of the depth, 1 / metre.
    """
    blur = sight.defocus - sight.focus * per
    least = sight.sharp + sight.blurred * (blur * blur)
    enough = (2.0 * least <= square) & (determinant >= sight.area)
    return np.asarray(enough & (least * least + determinant * determinant >= square * least))


def hidden_by_others(sight: FiducialSight, offset: FloatArray, normals: FloatArray) -> BoolArray:
    """Mask `(K,)` of the tags whose centre or one of whose corners is behind the footprint of another tag.

    A footprint does not hide points at most `TOLERANCE` metres behind its plane, such as tags on its own wall. `offset`
    `(K, 3)` are the offsets of the tags from the camera, metres, and `normals` `(K, 3)` their unit normals.
    """
    right, up = upright(normals)
    half = np.reshape(sight.half, (-1, 1))  # one number, or a column
    r, s = half * right, half * up
    points = np.stack([offset, *(offset + way for way in (r + s, -(r + s), r - s, -(r - s)))])  # (5, K, 3)
    height = -dot(normals, offset)  # height of the camera above the plane of A, (K,)
    side = dot(normals, points[:, :, None]) + height  # heights of the points of B above the plane of A, (5, B, A)
    crosses = ((height > 0.0) & (side < -TOLERANCE)) | ((height < 0.0) & (side > TOLERANCE))
    b, a = np.nonzero(crosses.any(axis=0))  # few tags are behind the plane of another
    with np.errstate(all="ignore"):  # `share` is arbitrary for a line that does not cross the plane
        share = height[a] / (height[a] - side[:, b, a])
        at = share[..., None] * points[:, b] - offset[a]
        farthest = np.maximum(abs(dot(right[a], at)), abs(dot(up[a], at)))
    within = farthest <= np.broadcast_to(sight.footprint, height.shape)[a]
    hidden = np.zeros(len(offset), dtype=np.bool_)
    hidden[b[(crosses[:, b, a] & within).any(axis=0) & (a != b)]] = True
    return hidden
