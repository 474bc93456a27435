"""Rooms of headsets and phones, see `captured`."""

import json
from pathlib import Path

import numpy as np
import pytest
from captured import ROOMS, anchor
from numpy.testing import assert_allclose

from lmd.formats.meshes import read_mesh, read_mesh_room

REAL = Path(__file__).parents[2] / "../shared/real/rooms"


@pytest.mark.parametrize("kind", ROOMS)
def test_what_was_captured_is_a_room(kind, write):
    path = write(json.dumps(ROOMS[kind]), "room.json")
    room = read_mesh_room(path, {"height": [0.5, 1.9], "clearance": 0.3}, 0.5)
    low, high = room.bounds()
    assert_allclose([low, high], [[-2, -1.5, 0], [2, 1.5, 2.5]], atol=1e-6)
    areas = {tuple(s.normal.round(3) + 0.0): s.area for s in room.surfaces() if not s.name.startswith("storage")}
    walls = {(0, 1, 0): 8.0, (0, -1, 0): 9.2, (1, 0, 0): 7.5, (-1, 0, 0): 7.5, (0, 0, 1): 11.5}
    ceiling = {} if kind == "RoomPlan" else {(0, 0, -1): 12.0}
    assert areas == pytest.approx(walls | ceiling, abs=1e-3)
    chest = np.concatenate([s.parts.reshape(-1, 2).max(axis=0) for s in room.surfaces() if "storage" in s.name])
    assert chest.max() == pytest.approx(1.0)
    things = {thing.name: (thing.corners.min(axis=0), thing.corners.max(axis=0)) for thing in room.fixtures()}
    assert_allclose(things["storage_0"], [[-0.5, 1.0, 0], [0.5, 1.5, 0.8]], atol=1e-6)
    door = np.array(next(things[name] for name in things if "door" in name))
    assert_allclose(door, [[-0.5, -1.5, 0], [0.5, -1.5, 2]], atol=1e-6)


def test_a_polygon_may_have_any_shape(write):
    ring = [[0, 0], [4, 0], [4, 3], [2, 3], [2, 1], [0, 1]]
    floor = anchor("FLOOR", [0, 0, 0], [270, 0, 0], PlaneBoundary2D=ring)
    mesh = read_mesh(write(json.dumps({"CoordinateSystem": "Unity", "Rooms": [{"Anchors": [floor]}]}), "room.json"))
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    assert np.abs(np.cross(b - a, c - a)[:, 2]).sum() / 2.0 == pytest.approx(8.0)
    assert_allclose(np.unique(mesh.vertices, axis=0), np.unique([[x, -y, 0] for x, y in ring], axis=0), atol=1e-6)


def test_a_real_room_is_what_was_derived_of_it():
    if not REAL.is_dir():
        pytest.skip(f"{REAL} is not here")
    captured = read_mesh(REAL / "office_small.json")
    assert [name for name, _ in captured.on_walls] == ["wall_art_0", "window_frame_0", "door_frame_0"]
    derived = read_mesh(REAL / "office_small.obj", up="y")
    for name in captured.names:
        mine, theirs = (
            mesh.vertices[np.unique(mesh.faces[mesh.of == mesh.names.index(name)])] for mesh in (captured, derived)
        )
        apart = np.linalg.norm(mine[:, None] - theirs, axis=-1)
        assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 1e-4
