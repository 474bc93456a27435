"""Rooms over floor plans that tests share, and random ones."""

import itertools

import numpy as np
import shapely
from hypothesis import strategies as st

from lmd.space.floor_plan import FloorPlan
from lmd.space.parts import Reachable
from lmd.space.prism import Prism

L_SHAPE = [[0, 0], [6, 0], [6, 2], [3, 2], [3, 4], [0, 4]]
PILLAR = [[1.25, 1.25], [1.75, 1.25], [1.75, 1.75], [1.25, 1.75]]
RACK = {"low": [0, 3, 0], "high": [0.5, 4, 1.75], "faces": ["x_max", "top"]}
DOOR = {"name": "door", "surface": "wall_0", "from_left": [0.5, 1.5], "from_below": [0, 2]}


def lab(spacing=0.5, clearance=0.25, height=(0.5, 1.5), **plan):
    """An L with a pillar and a rack."""
    given = {"holes": [PILLAR], "obstacles": [RACK], "keep_out": [DOOR], "band": [0.25, 2.25], **plan}
    return Prism(FloorPlan(L_SHAPE, 2.5, **given), Reachable(height, clearance), spacing)


def blocks(rng, size=5, cuts=4):
    """A square less random rectangles, with random holes: many corners in one line."""
    while True:
        corners = [np.sort(rng.integers(0, size + 1, (2, 2)), axis=0).ravel() for _ in range(cuts)]
        left = shapely.box(0, 0, size, size).difference(shapely.union_all([shapely.box(*box) for box in corners]))
        if left.geom_type == "Polygon" and left.area > 0.0 and _are_apart([left.exterior, *left.interiors]):
            return shapely.orient_polygons(left.simplify(0.0))


def star(rng, corners=9, pillar=True):
    """A polygon with slanting edges around the point (3, 3), and a triangle in it."""
    angle = (np.arange(corners) + rng.uniform(0.1, 0.9, corners)) * 2.0 * np.pi / corners
    ring = 3.0 + rng.uniform(1.0, 3.0, corners)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    turn = rng.uniform(0.0, 2.0 * np.pi) + np.arange(3) * 2.0 * np.pi / 3.0
    hole = 3.0 + 0.3 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return shapely.Polygon(ring, [hole] if pillar else [])


def _are_apart(rings):
    return all(a.disjoint(b) for a, b in itertools.combinations(rings, 2))


def plan_of(polygon, height=2.5, **more):
    """The floor plan of a polygon of shapely."""
    holes = [ring.coords[:-1] if ring.is_ccw else ring.coords[-1:0:-1] for ring in polygon.interiors]
    return FloorPlan(list(polygon.exterior.coords[:-1]), height, holes=[list(hole) for hole in holes], **more)


def random_boxes(rng, count, size):
    """Corners of boxes in a room of `size`, `(count, 2, 3)`, some of them on the floor or against a wall."""
    low = rng.uniform(0.0, 0.8, (count, 3)) * size
    low[rng.random((count, 3)) < 0.2] = 0.0
    return np.stack([low, np.minimum(low + rng.uniform(0.1, 0.4, (count, 3)) * size, size)], axis=1)


def hangs_properly(room, points, surfaces, edge=0.0):
    """Return whether squares around `points` lie in the free part of their surface, by shapely."""
    good = []
    for point, number in zip(points, surfaces, strict=True):
        on = room.surfaces()[number]
        a, b = (float((point - on.origin) @ way) for way in (on.u, on.v))
        half = max(edge / 2.0 - 1e-6, 1e-9)
        square = shapely.box(a - half, b - half, a + half, b + half)
        free = shapely.box(0, 0, *on.extent) if on.allowed is None else on.allowed
        good.append(free.buffer(1e-6).covers(square))
    return np.array(good)


@st.composite
def prisms(draw, spacing=0.9):
    """Rooms of all kinds, with obstacles."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    polygon = blocks(rng, 3) if draw(st.booleans()) else star(rng)
    obstacles = []
    for low, high in random_boxes(rng, draw(st.integers(0, 4)), np.array([6.0, 6.0, 2.5])):
        if polygon.covers(shapely.box(*low[:2], *high[:2])):
            obstacles.append({"low": low.tolist(), "high": high.tolist()})
    plan = plan_of(polygon, obstacles=obstacles, surfaces=["floor", "ceiling", "wall_0", "wall_1", "wall_2"])
    return Prism(plan, Reachable((0.3, 2.0)), spacing, positions=draw(st.sampled_from(["cells", "vertices"])))
