"""Measures of image quality that decide whether a tag is detected: pitch (pixels per module), apparent edge length and
incidence angle. Also the errors of detected corners as functions of the pitch.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from lmd.core.checks import Checked, FloatArray, InputError, NotNegative
from lmd.geometry.camera import Camera
from lmd.geometry.projection import intrinsics, slope, to_camera
from lmd.scene.tag import Tag


def pitch(
    camera: Camera,
    pose: FloatArray,
    centres: FloatArray,
    normals: FloatArray,
    tag: Tag,
    edges: FloatArray | None = None,
) -> FloatArray:
    """Pitch of tags: pixels per module along the most foreshortened direction.

    The pitch is the smaller singular value of J times edge / N. J is the Jacobian of the projection with respect to
    displacements in the tag's plane, and N the number of modules along an edge. With s = |J|_F^2 and d = |det J| the
    singular value is d / sqrt((s + sqrt(s^2 - 4 d^2)) / 2).

    Args:
        camera: intrinsics and lens.
        pose: poses of the camera, camera to world, `(..., 4, 4)`.
        centres: centres of the tags, world frame, metres, `(K, 3)`.
        normals: unit normals of the front faces, `(K, 3)`.
        tag: tag type, with the number of modules, and with the edge length unless `edges` are given.
        edges: edge length of each tag, metres, `(K,)`; None for the edge length of `tag`.

    Returns:
        pitches, pixels per module, `(..., K)`, also for tags seen from behind; NaN for tags behind the camera or
        outside the view of its lens.
    """
    square, determinant = _stretch(camera, pose, centres, normals)
    root = np.sqrt(np.maximum(square**2 - 4.0 * determinant**2, 0.0))
    module = (tag.size if edges is None else edges) / tag.modules
    return np.asarray(determinant / np.sqrt((square + root) / 2.0) * module)


def apparent_edge(
    camera: Camera,
    pose: FloatArray,
    centres: FloatArray,
    normals: FloatArray,
    tag: Tag,
    edges: FloatArray | None = None,
) -> FloatArray:
    """Edge length, pixels, of a square whose area equals that of the tag's image: sqrt(|det J|) times the tag's edge
    length.

    J is the Jacobian of the projection with respect to displacements in the tag's plane.

    Args:
        camera: intrinsics and lens.
        pose: poses of the camera, camera to world, `(..., 4, 4)`.
        centres: centres of the tags, world frame, metres, `(K, 3)`.
        normals: unit normals of the front faces, `(K, 3)`.
        tag: tag type, with the edge length unless `edges` are given.
        edges: edge length of each tag, metres, `(K,)`; None for the edge length of `tag`.

    Returns:
        apparent edge lengths, `(..., K)`; NaN for tags behind the camera or outside the view of its lens.
    """
    _, determinant = _stretch(camera, pose, centres, normals)
    return np.asarray(np.sqrt(determinant) * (tag.size if edges is None else edges))


def incidence(pose: FloatArray, centres: FloatArray, normals: FloatArray) -> FloatArray:
    """Incidence angle: angle between a tag's normal and the direction from the tag's centre to the camera.

    Args:
        pose: poses of the camera, camera to world, `(..., 4, 4)`.
        centres: centres of the tags, world frame, metres, `(K, 3)`.
        normals: unit normals of the front faces, `(K, 3)`.

    Returns:
        angles, rad in [0, pi], `(..., K)`; the front is visible below pi / 2.
    """
    towards = pose[..., None, :3, 3] - centres
    along = (towards * normals).sum(axis=-1)
    across = np.linalg.norm(np.cross(towards, normals), axis=-1)
    return np.asarray(np.arctan2(across, along))


def _stretch(
    camera: Camera, pose: FloatArray, centres: FloatArray, normals: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Values |J|_F^2 and |det J| of each tag, pixels^2 / metre^2, `(..., K)` each. J is the Jacobian of the projection
    with respect to displacements in the tag's plane. The values are NaN for tags behind the camera or outside the view
    of its lens.
    """
    y, n = to_camera(pose, centres), np.asarray(normals @ pose[..., :3, :3])
    if camera.lens is not None:
        angle = np.arctan2(np.hypot(y[..., 0], y[..., 1]), y[..., 2])
        moves = slope(camera, np.where((angle <= camera.widest_angle)[..., None], y, np.nan))
        along = (moves * n[..., None, :]).sum(axis=-1)
        area = np.abs((np.cross(moves[..., 0, :], moves[..., 1, :]) * n).sum(axis=-1))
        return np.asarray((moves**2).sum(axis=(-2, -1)) - (along**2).sum(axis=-1)), np.asarray(area)
    focal = np.diag(intrinsics(camera))[:2]
    depth = np.where(y[..., 2] > 0.0, y[..., 2], np.nan)
    ray = y[..., :2] / depth[..., None]
    scale = (focal / depth[..., None]) ** 2
    moved = n[..., :2] - ray * n[..., 2:]  # P n without the factors f / z
    determinant = focal.prod() * np.abs((n * y).sum(axis=-1)) / depth**3
    return np.asarray((scale * (1.0 + ray**2 - moved**2)).sum(axis=-1)), np.asarray(determinant)


# 90 % quantile of the standard normal distribution.
NORMAL_QUANTILE_90 = 1.2815515655446004
LEAST_ANGLE = 0.2  # lower bound on the sine of the angle at a corner, so that the corner's shift stays bounded


# Minimum standard deviation of corners without the mean shift, relative to the deviation with the shift.
LEAST_SHARE = 0.1


@dataclass(frozen=True)
class CornerErrors(Checked):
    """Log-normal distribution of the root mean square error of a tag's four corners, as a function of the pitch.

    The distribution is given by two quantiles, `median` and `high`, at several pitches. Between these pitches, the
    logarithm of a quantile is linear in the logarithm of the pitch; beyond them, the quantiles are constant. The errors
    of the eight corner coordinates form a vector, whose direction is uniformly distributed.

    Raises:
        InputError: `median`, `high` or `inward` has another length than `pitch`, or `inward_spread` is negative.
    """

    pitch: tuple[float, ...]
    """Pitch: pixels per module along the most foreshortened direction, ascending, `(B,)`."""
    median: tuple[float, ...]
    """Median of the error (root mean square over the four corners) at these pitches, pixels, `(B,)`."""
    high: tuple[float, ...]
    """90 % quantile of the error at these pitches, pixels, `(B,)`."""
    inward: tuple[float, ...] = ()
    """Mean shift of a tag's edges towards its centre at these pitches, pixels, `(B,)`; the error includes this shift.
    An empty tuple means no shift.
    """
    inward_spread: NotNegative = 0.0
    """Standard deviation of the shift `inward` if blur and exposure vary, pixels; for one camera under constant light
    the shift is constant.
    """

    def _validate(self) -> None:
        object.__setattr__(self, "inward", self.inward or (0.0,) * len(self.pitch))
        for name in ("median", "high", "inward"):
            if len(getattr(self, name)) != len(self.pitch):
                raise InputError(
                    f"{name} = {getattr(self, name)} must have a value for each of {len(self.pitch)} pitches."
                )

    def _at(self, pitch: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of the logarithm of the corner error, each in the shape of `pitch`."""
        at, known = np.log(pitch), np.log(self.pitch)
        mean, high = (np.interp(at, known, np.log(values)) for values in (self.median, self.high))
        return mean, (high - mean) / NORMAL_QUANTILE_90

    def draw(self, pitch: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw random corner errors of tags, pixels, `(..., 4, 2)`.

        `pitch` has the pitches of the tags, pixels per module, `(...)`.
        """
        mean, spread = self._at(pitch)
        error = np.exp(mean + spread * rng.standard_normal(pitch.shape))
        direction = rng.standard_normal((*pitch.shape, 4, 2))
        square = (direction**2).sum(axis=-1).mean(axis=-1)
        return np.asarray(direction * (error / np.sqrt(square))[..., None, None])

    def inward_at(self, pitch: FloatArray) -> FloatArray:
        """Mean shift of a tag's edges towards its centre, pixels, in the shape of `pitch`.

        The shift is interpolated linearly in the logarithm of the pitch.
        """
        return np.asarray(np.interp(np.log(pitch), np.log(self.pitch), self.inward))

    def independent_sigma(self, pitch: FloatArray) -> FloatArray:
        """Standard deviation of the error of one corner coordinate, pixels, in the shape of `pitch`.

        The mean shift of the tag's edges towards its centre (`inward`) is not included.
        """
        whole = self.sigma(pitch)
        return np.asarray(np.sqrt(np.maximum(whole**2 - self.inward_at(pitch) ** 2, (LEAST_SHARE * whole) ** 2)))

    def sigma(self, pitch: FloatArray) -> FloatArray:
        """Root mean square error of one corner coordinate, pixels, in the shape of `pitch`.

        The mean shift of the tag's edges towards its centre (`inward`) is included.
        """
        mean, spread = self._at(pitch)
        return np.asarray(np.exp(mean + spread**2) / np.sqrt(2.0))


# Projections of the corners' errors onto the modes of `MeasuredCorners.modes`, in the order of `squares.CORNERS`.
ALIKE, DIAGONAL = np.full((4, 4), 0.25), 0.25 * np.outer([-1.0, 1.0, -1.0, 1.0], [-1.0, 1.0, -1.0, 1.0])
MODES = np.stack([ALIKE, np.eye(4) - ALIKE - DIAGONAL, DIAGONAL])
# For `MeasuredCorners`: minimum number of tags in a class, and maximum numbers of classes of pitch and of incidence.
LEAST_TAGS, MOST_CLASSES, OBLIQUE_CLASSES = 40, 12, 3


def inward(image: FloatArray) -> FloatArray:
    """Displacement of the corners of N tags, pixels, `(N, 4, 2)`, if all edges of a tag move by one pixel towards the
    middle of the tag. `image` has the corners in the image, pixels, `(N, 4, 2)`.
    """
    (along, other) = (np.roll(image, way, axis=1) - image for way in (1, -1))
    along, other = (edge / np.linalg.norm(edge, axis=-1, keepdims=True) for edge in (along, other))
    across = np.abs(along[..., 0] * other[..., 1] - along[..., 1] * other[..., 0])
    return np.asarray((along + other) / np.maximum(across, LEAST_ANGLE)[..., None])


def shortest_side(image: FloatArray) -> FloatArray:
    """Length of the shortest side of each tag, pixels, `(N,)`, from the corners in the image, `(N, 4, 2)`."""
    return np.asarray(np.linalg.norm(image - np.roll(image, 1, axis=1), axis=-1).min(axis=1))


@dataclass(frozen=True)
class MeasuredCorners:
    """Corner errors of one detector with one camera and lighting: independent noise, and a shift of the tag's edges.

    The noise depends on pitch and incidence angle, the shift on the pitch.
    """

    pitch: tuple[float, ...]
    """Pitches, pixels per module, ascending, `(B,)`; the fields below are interpolated in the logarithm of the pitch.
    """
    noise: tuple[float, ...]
    """Standard deviation of one coordinate of one corner without the mean shift, pixels, `(B,)`."""
    inward: tuple[float, ...]
    """Mean shift of a tag's edges towards its centre, pixels, `(B,)`."""
    incidence: tuple[float, ...]
    """Incidence angles, rad, ascending, `(I,)`; `oblique` is interpolated linearly between these angles."""
    oblique: tuple[float, ...]
    """Variance of the noise at these incidence angles, divided by its variance over all angles at equal pitch, `(I,)`.
    """
    modes: tuple[float, ...]
    """Variances of the three modes of a tag's noise, divided by their mean. The modes are errors that are equal at all
    corners; errors that are linear in the corner's position on the tag; and errors with opposite signs on the two
    diagonals. The modes have 2, 4 and 2 of the eight dimensions.
    """

    @classmethod
    def of(cls, pitch: FloatArray, incidence: FloatArray, error: FloatArray, image: FloatArray) -> "MeasuredCorners":
        """Estimate the noise and the shift from the corner errors of N detected tags.

        The tags are divided into bins of pitch, each with at least `LEAST_TAGS` tags.

        Args:
            pitch: pitches of the tags, pixels per module, `(N,)`.
            incidence: incidence angles, rad, `(N,)`.
            error: detected minus exact corners, pixels, `(N, 4, 2)`.
            image: exact corners, pixels, `(N, 4, 2)`.

        Raises:
            InputError: there are fewer than `LEAST_TAGS` tags.
        """
        if len(pitch) < LEAST_TAGS:
            raise InputError(f"frames: {len(pitch)} tags were detected, but {LEAST_TAGS} are needed.", "frames")
        unit, count = inward(image), len(pitch)
        shift = (error * unit).sum(axis=(1, 2)) / (unit**2).sum(axis=(1, 2))
        rows, relative = [], np.empty_like(error)
        for own in np.array_split(np.argsort(pitch, kind="stable"), min(max(count // LEAST_TAGS, 1), MOST_CLASSES)):
            mean = shift[own].mean()
            rest = error[own] - mean * unit[own]
            sigma = np.sqrt((rest**2).mean())
            relative[own] = rest / sigma
            rows.append((np.exp(np.log(pitch[own]).mean()), sigma, mean))
        thirds = np.array_split(np.argsort(incidence, kind="stable"), OBLIQUE_CLASSES)
        slants = tuple(float(incidence[own].mean()) for own in thirds)
        factors = np.array([(relative[own] ** 2).mean() for own in thirds])
        relative /= np.sqrt(np.interp(incidence, slants, factors))[:, None, None]
        oblique = tuple(map(float, factors * (relative**2).mean()))
        relative /= np.sqrt((relative**2).mean())
        modes = tuple(float(((mode @ relative) ** 2).sum() / (2.0 * count * np.trace(mode))) for mode in MODES)
        pitches, noise, shifts = (tuple(map(float, column)) for column in zip(*rows, strict=True))
        return cls(pitches, noise, shifts, slants, oblique, modes)

    def independent_sigma(self, pitch: FloatArray, incidence: FloatArray) -> FloatArray:
        """Standard deviation of the error of one corner coordinate, pixels, `(...)`.

        The mean shift of the tag's edges is not included.

        Args:
            pitch: pitches, pixels per module, `(...)`.
            incidence: incidence angles, rad, `(...)`.
        """
        sigma = np.exp(np.interp(np.log(pitch), np.log(self.pitch), np.log(self.noise)))
        return np.asarray(sigma * np.sqrt(np.interp(incidence, self.incidence, self.oblique)))

    def inward_at(self, pitch: FloatArray) -> FloatArray:
        """See `CornerErrors.inward_at`."""
        return np.asarray(np.interp(np.log(pitch), np.log(self.pitch), self.inward))


# Geometric means of the bounds of the classes of pitch, pixels per module.
PITCH_MIDDLES = tuple(math.sqrt(low * high) for low, high in pairwise((1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 6.0, 9.0)))
# Errors were measured in 400 rendered frames of uniform tags of 10 cm, by the study `detect` of evaluate, with
# tags of the family 36h11 and an ordinary camera in good light: 72 to 793 tags per class. Shifts were measured in
# images of another renderer without clipping and tone curve, `python benchmarks/corners.py preset --tags 24`, of tags
# with the margin that lmd prints. A tone curve adds 0.24 pixels to the shift, clipped white 0.32 pixels; the cameras of
# docs/results/survey.md have shifts of -0.07 to 0.03 pixels. Blur changes the shift of ArUco by similar amounts.
LIGHT_SPREAD, BLUR_SPREAD = 0.1, 0.2
CORNER_ERRORS = {
    "aruco": CornerErrors(
        PITCH_MIDDLES,
        (1.007, 0.908, 0.824, 0.703, 0.616, 0.545, 0.306, 0.273),
        (1.400, 1.406, 1.126, 0.964, 0.878, 0.778, 0.668, 0.343),
        (0.268, 0.289, 0.267, 0.245, 0.308, 0.314, 0.237, 0.167),
        BLUR_SPREAD,
    ),
    "apriltag": CornerErrors(
        PITCH_MIDDLES,
        (0.228, 0.193, 0.180, 0.135, 0.080, 0.033, 0.017, 0.017),
        (0.363, 0.280, 0.236, 0.200, 0.131, 0.057, 0.042, 0.039),
        (0.025, 0.025, 0.022, 0.021, 0.012, 0.005, 0.001, 0.001),
        LIGHT_SPREAD,
    ),
    # There are hardly any detections below 1.5 pixels per module.
    "apriltag_decimate2": CornerErrors(
        PITCH_MIDDLES[1:],
        (0.244, 0.212, 0.151, 0.084, 0.034, 0.018, 0.016),
        (0.497, 0.383, 0.253, 0.147, 0.063, 0.040, 0.039),
        # Below 2 pixels per module there are too few detections; the shift at 2.24 pixels per module is used.
        (0.046, 0.046, 0.046, 0.017, 0.006, 0.000, 0.000),
        LIGHT_SPREAD,
    ),
}
