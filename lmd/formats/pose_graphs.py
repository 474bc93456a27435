"""Tags among the vertices of a g2o pose graph that RTAB-Map exported.

A landmark with a rotation is a vertex `VERTEX_SE3:QUAT`, as is a pose. Landmarks come first, in descending order of
their numbers. Edges to landmarks are `EDGE_SE3`, edges between poses `EDGE_SE3:QUAT`. The number of a landmark's vertex
is the tag's number plus the greatest number of a pose; other programs write the tag's number with a minus. A landmark
without a rotation is a point.

Source: `OptimizerG2O::saveGraph` of introlab/rtabmap; its issue 1199 has a file.
"""

from typing import Any

import numpy as np

from lmd.core.checks import InputError
from lmd.formats.placed_tag import Found, PlacedTag, number_of, turn_by_quaternion

POSE, POINTS = "VERTEX_SE3:QUAT", ("VERTEX_TRACKXYZ", "VERTEX_XY", "VERTEX_POINT_XYZ")
PLANAR = "VERTEX_SE2"
EDGE, TO_LANDMARK = "EDGE_", "EDGE_SE3"
POSE_VALUES = 7  # number of values of a pose: x, y, z, qx, qy, qz, qw
AS_POSES = (
    "export the poses as RGB-D SLAM with ids, landmarks included (rtabmap-export --poses --poses_format 11), which is "
    "read"
)


def read_graph(path: Any, text: str) -> Found:
    """Tags of a graph.

    Raises:
        InputError: the graph has no landmark, or only landmarks without a rotation.
    """
    poses, points, landmarks = dict[int, list[float]](), set[int](), set[int]()
    planar = edges = False
    for count, line in enumerate(text.splitlines(), 1):
        word, *values = line.split() or [""]
        try:
            if word == POSE:
                poses[int(values[0])] = _finite(values[1:])
            elif word in POINTS:
                points.add(int(values[0]))
            elif word == TO_LANDMARK:
                landmarks.add(max(int(values[0]), int(values[1])))
            planar |= word == PLANAR
            edges |= word.startswith(EDGE)
        except (ValueError, IndexError):
            raise InputError(f"line {count}, {line[:80]!r}, must be {word}, whole numbers and numbers.") from None
    negative = {vertex for vertex in poses if vertex < 0}
    landmarks = negative or _leading(list(poses)) or landmarks & poses.keys()
    if not landmarks or not (negative or edges):
        raise InputError(_reason(len(poses), len(points), planar))
    offset = 0 if negative else max(poses.keys() - landmarks, default=0)
    tags = []
    for vertex in sorted(landmarks):
        number = -vertex if negative else vertex - offset
        if number < 0:
            raise InputError(f"the landmark {vertex} must have a greater number than the pose {offset}.")
        x, y, z, *turn = poses[vertex]
        tags.append(PlacedTag(number_of(number), np.array([x, y, z]), turn_by_quaternion(*turn)))
    counted = "have a minus" if negative else f"are counted from the pose {offset} on"
    return Found(tags, None, True, f"{path}: its tags are the landmarks of a graph of g2o, whose numbers {counted}")


def _leading(vertices: list[int]) -> set[int]:
    """Vertices before the least number, if each number exceeds the least number and all numbers that follow its own."""
    poses = vertices[vertices.index(min(vertices)) :] if vertices else []
    leading = vertices[: len(vertices) - len(poses)]
    return set(leading) if leading and min(leading) > max(poses) else set()


def _finite(values: list[str]) -> list[float]:
    """Values of a pose; raises `ValueError` if they are not seven finite numbers."""
    found = [float(value) for value in values]
    if len(found) != POSE_VALUES or not np.isfinite(found).all():
        raise ValueError
    return found


def _reason(poses: int, points: int, planar: bool) -> str:
    """Reason for the lack of tags with poses in a graph, and advice on exporting a file that has them."""
    if planar:
        return f"it is a graph of g2o in two dimensions, in which tags have no height: {AS_POSES}."
    if points:
        return f"it has {points} landmarks of g2o with places and without rotations: {AS_POSES}."
    return f"it is a graph of g2o with {poses} poses and without edges to a landmark: {AS_POSES}."
