"""Range of distances at which a camera detects a single tag, and the error of the camera pose from that tag.

The tag hangs upright in the middle of the image and is turned about the vertical by the incidence angle. A tag that
meets all criteria of the visibility model is called "read", as it can be detected.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

import numpy as np

from lmd.core.checks import Checked, FloatArray, Positive, vector
from lmd.estimation.cramer_rao import cramer_rao_bound, pose_information
from lmd.export.paper import PAPERS, largest_whole
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import camera_pose
from lmd.geometry.squares import corners, upright
from lmd.scene.criteria import Criteria
from lmd.scene.tag import Tag
from lmd.sight.models.fiducial import Fiducial

NEAREST, FARTHEST = 0.01, 1000.0  # least and greatest distance that is tried, metres
DISTANCE_STEPS = 400  # number of distances tried, by equal factors of 1.03
COARSE_STEPS = 8  # steps between the sizes that are tried first
RELATIVE_TOLERANCE = 1e-4
MOST_ATTITUDE_RAD = 0.35  # greatest attitude error, rad (20 degrees), for which the linear prediction is valid


@dataclass(frozen=True)
class Reach:
    """Range of distances at which a tag is read; both limits are NaN if the tag is not read at any distance.

    A tag that is too near does not fit into the image, or is out of focus.
    """

    nearest: float
    """Least distance, metres."""
    farthest: float
    """Greatest distance, metres."""


def _hung(distance: float, incidence: float) -> tuple[FloatArray, FloatArray]:
    """Position and normal of a tag in front of a camera, `(1, 3)` each. The camera is at the origin and looks along y;
    the tag is at the given distance, metres, and incidence angle, rad.
    """
    return np.array([[0.0, distance, 0.0]]), np.array([[math.sin(incidence), -math.cos(incidence), 0.0]])


def is_read(criteria: Criteria, camera: Camera, distance: float, incidence: float) -> bool:
    """Return True if a tag is read, that is, meets all criteria, at a distance, metres, and an incidence angle, rad."""
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
    """Find the edge length of the smallest tag that is read at a distance, metres; NaN if no tag is read there.

    Args:
        criteria_of: function that makes the criteria for tags of a given edge length, metres.
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
    """Value between `inside` and `outside` at which `holds` changes from True to False, found by bisection; `holds` is
    still True at the value returned. `holds` must be True at `inside`.
    """
    while abs(outside - inside) > RELATIVE_TOLERANCE * max(abs(inside), abs(outside)):
        middle = (inside + outside) / 2.0
        inside, outside = (middle, outside) if holds(middle) else (inside, middle)
    return float(inside)


def pose_bounds(
    camera: Camera, tag: Tag, distances: Sequence[float], incidence: float, pixel_noise: float
) -> tuple[FloatArray, FloatArray]:
    """Cramer-Rao bound on the camera pose from the corners of one tag, see `lmd.estimation.cramer_rao`.

    Args:
        camera: the camera.
        tag: the tag, which has an edge length.
        distances: D distances of the camera from the tag, metres.
        incidence: incidence angle, rad.
        pixel_noise: standard deviation of a detected corner, pixels.

    Returns:
        standard deviations of position, metres, and attitude, rad, `(D,)` each.
    """
    pose = camera_pose(np.zeros((1, 3)), [0.0], [0.0])
    errors = []
    for distance in distances:
        place, normal = _hung(distance, incidence)
        points = corners(place, normal, upright(normal)[1], tag.size)[0]
        errors.append(
            cramer_rao_bound(
                pose_information([camera], np.eye(4)[None], pose, points, np.ones((1, 4), dtype=bool)[None])
            )
        )
    position, attitude = pixel_noise * np.array(errors)[:, :, 0].T
    return position, attitude


@dataclass(frozen=True)
class Reading(Checked):
    """Angles and distances for which the range and the pose error of a tag are computed.

    Raises:
        InputError: a value is out of range.
    """

    incidence: Annotated[Sequence[float], partial(vector, size=None, low=0.0, high=90.0)] = (0.0, 30.0, 45.0, 60.0)
    """Angles between the tag's normal and the line of sight, degrees."""
    distance: Annotated[Sequence[float], partial(vector, size=None, above=0.0)] = (0.5, 1.0, 2.0, 4.0, 8.0)
    """Distances of the tag from the camera, metres."""
    pixel_noise: Positive = 0.5
    """Standard deviation of a detected corner, pixels."""


def reach_text(camera: Camera, tag: Tag, criteria: Fiducial, reading: Reading) -> str:
    """Text with tables of the range and pose error of each size of the tag, and of the smallest tag that is read.

    For each size, a table has the range of distances at which the tag is read, and the errors of the pose estimated
    from this tag. The last table has the edge length of the smallest tag that is read.
    """
    tags = [tag.of_size(edge) for edge in tag.sizes]
    lines = [
        *(f"tag      {t.family}, {t.square} {t.size:g} m, with its quiet zone {t.paper_edge:.4g} m" for t in tags),
        f"camera   {camera.image_width:g} x {camera.image_height:g} pixels",
        f"detector {criteria.detector}\n",
    ]
    for one in tags:
        lines += [f"{one.square} of {one.size:g} m"] * (len(tags) > 1)
        lines += [*_columns(_reads(camera, one, replace(criteria, tag=one), reading)), ""]
    lines += [f"smallest {tag.square} that is read, metres", *_columns(_edges(camera, tags[0], criteria, reading))]
    edges = {paper: math.floor(1e3 * largest_whole(tags[0], paper)) / 1e3 for paper in PAPERS}
    on_sheets = ", ".join(f"{edge:g} m ({paper})" for paper, edge in edges.items())
    return "\n".join([*lines, f"\nlargest {tag.square} on one sheet: {on_sheets}"])


def _reads(camera: Camera, tag: Tag, criteria: Fiducial, reading: Reading) -> list[list[str]]:
    """Table with a row for each incidence angle: the range of a tag, and the pose error at each distance within the
    range.
    """
    rows = [["incidence", "read from", "to", *(f"alone at {distance:g} m" for distance in reading.distance)]]
    for angle in reading.incidence:
        found = reach(criteria, camera, math.radians(angle))
        bounds = ["never", ""] if math.isnan(found.farthest) else [f"{found.nearest:.3g} m", f"{found.farthest:.3g} m"]
        errors = zip(*pose_bounds(camera, tag, reading.distance, math.radians(angle), reading.pixel_noise), strict=True)
        fixed = [
            _error(*error) if found.nearest <= distance <= found.farthest else "-"
            for distance, error in zip(reading.distance, errors, strict=True)
        ]
        rows.append([f"{angle:g} deg", *bounds, *fixed])
    return rows


def _error(position: float, attitude: float) -> str:
    """Text of the standard deviations of position and attitude; "not fixed" if the standard deviation of the attitude
    is `MOST_ATTITUDE_RAD` or more.
    """
    return f"{1e3 * position:.3g} mm, {math.degrees(attitude):.2g} deg" if attitude < MOST_ATTITUDE_RAD else "not fixed"


def _edges(camera: Camera, tag: Tag, criteria: Fiducial, reading: Reading) -> list[list[str]]:
    """Table of the edge length of the smallest tag that is read, with a row for each incidence angle and a column for
    each distance.
    """

    def of(edge: float) -> Fiducial:
        return replace(criteria, tag=replace(tag, edge=edge))

    rows = [["incidence", *(f"at {distance:g} m" for distance in reading.distance)]]
    for angle in reading.incidence:
        edges = [smallest_edge(of, camera, distance, math.radians(angle)) for distance in reading.distance]
        rows.append([f"{angle:g} deg", *("none" if math.isnan(edge) else f"{edge:.3g}" for edge in edges)])
    return rows


def _columns(rows: list[list[str]]) -> list[str]:
    """Lines of text, one for each row of the table `rows`, with aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["   ".join(f"{text:<{width}}" for text, width in zip(row, widths, strict=True)).rstrip() for row in rows]
