"""Rooms as meshes that tests share."""

import numpy as np
import shapely
import trimesh

from lmd.space.floor_plan import FloorPlan
from lmd.space.mesh_room import from_mesh


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
    return from_mesh(str(written(path, plan)), reachable, spacing, **{"up": "z", **more})
