"""Range of distances at which a camera reads a single tag, and the pose error from that tag.

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

NEAREST, FARTHEST = 0.01, 1000.0  # least and greatest distance that is tried, metres
DISTANCE_STEPS = 400  # number of distances tried, by equal factors of 1.03
COARSE_STEPS = 8  # steps between the sizes that are tried first
RELATIVE_TOLERANCE = 1e-4


@dataclass(frozen=True)
class Reach:
    """Range of distances at which a tag is read; NaN if the tag is not read at any distance.

    A tag that is too near does not fit into the image, or is out of focus.
    """

    nearest: float
    """Least distance, metres."""
    farthest: float
    """Greatest distance, metres."""


def _hung(distance: float, incidence: float) -> tuple[FloatArray, FloatArray]:
    """Position and normal `(1, 3)` of a tag ahead of a camera at the origin that looks along y."""
    return np.array([[0.0, distance, 0.0]]), np.array([[math.sin(incidence), -math.cos(incidence), 0.0]])


def is_read(criteria: Criteria, camera: Camera, distance: float, incidence: float) -> bool:
    """Return True if a tag is read at a distance, metres, and an incidence angle, rad."""
    axes = np.array([[0.0, 1.0, 0.0, 1.0, 0.0, 0.0]])
    return bool(criteria.covered(camera, np.zeros(3), axes, *_hung(distance, incidence))[0, 0])


def reach(criteria: Criteria, camera: Camera, incidence: float) -> Reach:
    """Find the range of distances at which a tag is read at an incidence angle, rad."""
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
    """Find the edge of the smallest tag that is read at a distance, metres; NaN if no tag is read.

    Args:
        criteria_of: function that makes the criteria for tags with an edge, metres.
        camera: the camera.
        distance: distance from the tag, metres.
        incidence: incidence angle, rad.
    """
    tried = distance * np.geomspace(1e-3, 1.0, DISTANCE_STEPS)

    def read(edge: float) -> bool:
        return edge > 0.0 and is_read(criteria_of(edge), camera, distance, incidence)

    # The sizes that are read form an interval; if no coarse size is read, all sizes are tried.
    for step in (COARSE_STEPS, 1):
        for index in range(0, DISTANCE_STEPS, step):
            if read(tried[index]):
                return _border(read, tried[index], tried[index - step] if index else 0.0)
    return math.nan


def _border(holds: Callable[[float], bool], inside: float, outside: float) -> float:
    """Value nearest to `outside` for which `holds` is True, by bisection from `inside`, where `holds` is True."""
    while abs(outside - inside) > RELATIVE_TOLERANCE * max(abs(inside), abs(outside)):
        middle = (inside + outside) / 2.0
        inside, outside = (middle, outside) if holds(middle) else (inside, middle)
    return float(inside)


def pose_bounds(
    camera: Camera, tag: Tag, distances: Sequence[float], incidence: float, pixel_noise: float
) -> tuple[FloatArray, FloatArray]:
    """Cramer-Rao bound of the pose from the corners of one tag, see `lmd.estimation.cramer_rao`.

    Args:
        camera: the camera.
        tag: tag with the edge.
        distances: D distances, metres.
        incidence: incidence angle, rad.
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
