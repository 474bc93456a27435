"""Rooms as meshes that tests share."""

import numpy as np
import shapely
import trimesh

from lmd.formats.meshes import read_mesh_room
from lmd.space.floor_plan import FloorPlan


def walls_of(plan: FloorPlan) -> trimesh.Trimesh:
    """Floor, ceiling, walls and pillars of a floor plan, seen from inside."""
    triangles = []
    for part in shapely.get_parts(shapely.constrained_delaunay_triangles(plan.ground)):
        a, b, c = np.array(shapely.orient_polygons(part).exterior.coords)[:3]
        triangles += [[(*p, 0.0) for p in (a, b, c)], [(*p, plan.height) for p in (c, b, a)]]
    for ring in shapely.get_parts(shapely.boundary(shapely.orient_polygons(plan.ground))):
        for start, end in zip(ring.coords[:-1], ring.coords[1:], strict=True):
            low_start, low_end, high_start, high_end = (
                (*start, 0),
                (*end, 0),
                (*start, plan.height),
                (*end, plan.height),
            )
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
