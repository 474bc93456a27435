"""How far away a camera reads one tag, and how well that tag alone fixes its pose: without a room or a deployment.

The tag hangs upright in the middle of the view and is turned about the vertical by the incidence angle.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lmd.core.checks import FloatArray
from lmd.estimation.cramer_rao import cramer_rao_bound, pose_information
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import camera_pose
from lmd.geometry.squares import corners, upright
from lmd.scene.criteria import Criteria
from lmd.scene.tag import Tag

NEAREST, FARTHEST = 0.01, 1000.0  # distances that are looked at, metres
DISTANCE_STEPS = 400  # between them, by equal factors: of 1.03
COARSE_STEPS = 8  # steps at once, of sizes
RELATIVE_TOLERANCE = 1e-4


@dataclass(frozen=True)
class Reach:
    """From where to where a tag is read, metres; NaN where it never is.

    A tag that is too near does not fit into the image, or is out of focus.
    """

    nearest: float
    farthest: float


def _hung(distance: float, incidence: float) -> tuple[FloatArray, FloatArray]:
    """The position and the normal `(1, 3)` of a tag ahead of a camera at the origin that looks along y."""
    return np.array([[0.0, distance, 0.0]]), np.array([[math.sin(incidence), -math.cos(incidence), 0.0]])


def is_read(criteria: Criteria, camera: Camera, distance: float, incidence: float) -> bool:
    """Whether a tag is read at a distance, metres, and an incidence angle, rad."""
    axes = np.array([[0.0, 1.0, 0.0, 1.0, 0.0, 0.0]])
    return bool(criteria.covered(camera, np.zeros(3), axes, *_hung(distance, incidence))[0, 0])


def reach(criteria: Criteria, camera: Camera, incidence: float) -> Reach:
    """From where to where a tag is read at an incidence angle, rad."""
    tried = np.geomspace(NEAREST, FARTHEST, DISTANCE_STEPS)
    read = np.flatnonzero([is_read(criteria, camera, distance, incidence) for distance in tried])
    if not read.size:
        return Reach(math.nan, math.nan)

    def edge(inside: int, outside: int) -> float:
        if not 0 <= outside < DISTANCE_STEPS:
            return float(tried[inside])
        return _border(lambda d: is_read(criteria, camera, d, incidence), tried[inside], tried[outside])

    return Reach(edge(read[0], read[0] - 1), edge(read[-1], read[-1] + 1))


def smallest_edge(criteria_of: Callable[[float], Criteria], camera: Camera, distance: float, incidence: float) -> float:
    """The edge of the smallest tag that is read at a distance, metres; NaN if none is.

    Args:
        criteria_of: makes the criteria for tags with an edge, metres.
        distance: from it, metres.
        incidence: angle, rad.
    """
    tried = distance * np.geomspace(1e-3, 1.0, DISTANCE_STEPS)

    def read(edge: float) -> bool:
        return edge > 0.0 and is_read(criteria_of(edge), camera, distance, incidence)

    # Sizes that are read have no gaps: those between two that are not read are tried only if none of these is.
    for step in (COARSE_STEPS, 1):
        for index in range(0, DISTANCE_STEPS, step):
            if read(tried[index]):
                return _border(read, tried[index], tried[index - step] if index else 0.0)
    return math.nan


def _border(holds: Callable[[float], bool], inside: float, outside: float) -> float:
    """The value nearest to `outside` for which something holds, as it does `inside`, by bisection."""
    while abs(outside - inside) > RELATIVE_TOLERANCE * max(abs(inside), abs(outside)):
        middle = (inside + outside) / 2.0
        inside, outside = (middle, outside) if holds(middle) else (inside, middle)
    return float(inside)


def pose_errors(
    camera: Camera, tag: Tag, distances: Sequence[float], incidence: float, pixel_noise: float
) -> tuple[FloatArray, FloatArray]:
    """The Cramer-Rao bound of the pose from the corners of one tag, `lmd.estimation.cramer_rao`.

    Args:
        distances: D of them, metres.
        incidence: angle, rad.
        pixel_noise: standard deviation of a corner, pixels.

    Returns:
        standard deviations of position, metres, and attitude, rad, `(D,)` each.
    """
    pose = camera_pose(np.zeros((1, 3)), [0.0], [0.0])
    errors = []
    for distance in distances:
        place, normal = _hung(distance, incidence)
        points = corners(place, normal, upright(normal)[1], tag.size)[0]
        errors.append(cramer_rao_bound(pose_information(pose, points, np.ones((1, 4), dtype=bool), camera)))
    position, attitude = pixel_noise * np.array(errors)[:, :, 0].T
    return position, attitude
