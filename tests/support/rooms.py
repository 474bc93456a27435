"""Rooms that tests share: over floor plans, of meshes, and maps of occupancy."""

import itertools

import numpy as np
import shapely
import trimesh
import yaml
from hypothesis import strategies as st
from PIL import Image

from lmd.formats.meshes import read_mesh_room
from lmd.formats.trajectories import read_recorded_poses
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


def recorded(path, **changes):
    """Recorded poses of a file."""
    settings = {"spacing": 0.5, "bandwidth": 0.2, "direction_bandwidth": 5.0, "divisions": 12, "held_out": None}
    return read_recorded_poses(path, **(settings | {"block": 1.0} | changes))


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


def walls_of(plan: FloorPlan) -> trimesh.Trimesh:
    """Floor, ceiling, walls and pillars of a floor plan, seen from inside."""
    triangles = []
    for part in shapely.get_parts(shapely.constrained_delaunay_triangles(plan.ground)):
        a, b, c = np.array(shapely.orient_polygons(part).exterior.coords)[:3]
        triangles += [[(*p, 0.0) for p in (a, b, c)], [(*p, plan.height) for p in (c, b, a)]]
    for ring in shapely.get_parts(shapely.boundary(shapely.orient_polygons(plan.ground))):
        for start, end in zip(ring.coords[:-1], ring.coords[1:], strict=True):
            low_start, low_end = (*start, 0), (*end, 0)
            high_start, high_end = (*start, plan.height), (*end, plan.height)
            triangles += [[low_start, high_end, low_end], [low_start, high_start, high_end]]
    vertices = np.array(triangles, dtype=float).reshape(-1, 3)
    mesh = trimesh.Trimesh(vertices, np.arange(len(vertices)).reshape(-1, 3), process=False)
    mesh.merge_vertices()
    return mesh


def written(path, plan):
    """A floor plan with its obstacles as a file of a mesh with an object for each, z up."""
    scene = trimesh.Scene()
    scene.add_geometry(walls_of(plan), node_name="shell")
    for i, obstacle in enumerate(plan.obstacles):
        box = trimesh.creation.box(bounds=[obstacle.low, obstacle.high])
        scene.add_geometry(box, node_name=f"box_{i}")
    scene.export(path)
    return path


def mesh_room(path, plan, height=(0.5, 1.5), clearance=0.25, spacing=0.5, **more):
    """A floor plan as a room from a mesh."""
    reachable = {"height": list(height), "clearance": clearance}
    return read_mesh_room(str(written(path, plan)), reachable, spacing, **{"up": "z", **more})


def quad(origin, u, v):
    """A rectangle of two triangles, by itself."""
    corners = np.array([origin, origin + u, origin + u + v, origin + v])
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def captured(path, rng):
    """A room as a headset captures it, z up: walls, floor, ceiling, a picture and furniture, each by itself.

    Nothing is quite in line: walls stick out beyond others and below the floor, or end a little before them, are not
    quite flat, furniture stands through floor and walls, and corners are rounded to micrometres.
    """
    size = rng.uniform([3.0, 3.0, 2.3], [5.0, 4.0, 2.8])
    parts = {}
    for axis, name in enumerate(("x", "y", "z")):
        across, up = ((1, 2), (0, 2), (0, 1))[axis]
        for side in (0, 1):
            out = rng.uniform(-0.004, 0.12, (2, 2))  # beyond each edge, or short of it
            origin, u, v = side * size * np.eye(3)[axis], *(size[i] * np.eye(3)[i] for i in (across, up))
            for way, i, (before, after) in ((u, across, out[0]), (v, up, out[1])):
                origin[i] -= before
                way[i] += before + after
            parts[f"{name}_{side}"] = quad(origin, u, v)
            parts[f"{name}_{side}"].vertices += rng.normal(0.0, 1e-4, (4, 3))
    for i in range(3):
        low = rng.uniform([-0.2, -0.2, -0.05], [size[0] - 0.6, size[1] - 0.6, 0.0])
        box = trimesh.creation.box(bounds=[low, low + rng.uniform([0.4, 0.4, 0.5], [0.9, 0.7, 0.9])])
        parts[f"box_{i}"] = box
    picture = rng.uniform([0.3, 0.0, 0.9], [1.0, 5e-4, 1.4])
    parts["picture"] = quad(picture, np.array([0.8, 0.0, 0.0]), np.array([0.0, 0.0, 0.6]))
    turn = trimesh.transformations.rotation_matrix(rng.uniform(0.0, 2.0 * np.pi), [0, 0, 1])
    scene = trimesh.Scene()
    for name, part in parts.items():
        part.apply_transform(turn)
        part.vertices = part.vertices.round(6)
        scene.add_geometry(part, node_name=name)
    scene.export(path)
    return path


FREE, UNKNOWN, OCCUPIED = 254, 205, 0
KEYS = {"resolution": 0.05, "origin": [-0.5, -0.5, 0.0], "negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.196}


def hall(width=6.0, depth=4.0, cell=0.05):
    """Grey values of a hall with walls of 0.1 m and unknown cells beyond; row 0 has the lowest y.

    The inner corner of the hall is 0.5 m from the corner of the picture.
    """
    rows, columns = round((depth + 1.0) / cell), round((width + 1.0) / cell)
    grey = np.full((rows, columns), UNKNOWN, dtype=np.uint8)
    box(grey, -0.1, -0.1, width + 0.1, depth + 0.1, OCCUPIED, cell)
    box(grey, 0.0, 0.0, width, depth, FREE, cell)
    return grey


def box(grey, x, y, x_end, y_end, value, cell=0.05):
    """Fill a box, metres from the inner corner of the hall."""
    a, b, c, d = (round((at + 0.5) / cell) for at in (x, y, x_end, y_end))
    grey[b:d, a:c] = value


def write_map(folder, grey, name="map", suffix=".pgm", **keys):
    """Write a picture and its YAML; returns the path of the YAML as a text."""
    Image.fromarray(grey[::-1]).save(folder / f"{name}{suffix}")
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump({"image": f"{name}{suffix}", **KEYS, **keys}))
    return str(path)
