"""One room of 4 x 3 x 2.5 m in the forms in which headsets and phones keep it, with numbers worked out by hand.

Its floor is around the origin. In the middle of the wall at y = -1.5 is a door of 1 x 2 m, before the opposite one
stands a chest of 1 x 0.5 x 0.8 m.
"""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lmd.core.checks import InputError
from lmd.space.mesh_file import read_mesh
from lmd.space.mesh_room import from_mesh

REAL = Path(__file__).parents[2] / "../shared/real/rooms"
HALF = math.sqrt(0.5)


def anchor(label, place, turn, **bounds):
    pose = {"Translation": place, "Rotation": turn, "Scale": [1, 1, 1]}
    return {"SemanticClassifications": [label], "Transform": pose, **bounds}


def plane(width, height):
    return {"PlaneBounds": {"Min": [-width / 2, -height / 2], "Max": [width / 2, height / 2]}}


# Unity: x to the right, y up, z ahead; z of an anchor points out of its plane, degrees about y turn clockwise.
MRUK = {
    "CoordinateSystem": "Unity",
    "Rooms": [
        {
            "Anchors": [
                anchor("FLOOR", [0, 0, 0], [270, 0, 0], PlaneBoundary2D=[[-2, -1.5], [2, -1.5], [2, 1.5], [-2, 1.5]]),
                anchor("CEILING", [0, 2.5, 0], [90, 0, 0], **plane(4, 3)),
                anchor("WALL_FACE", [0, 1.25, 1.5], [0, 180, 0], **plane(4, 2.5)),
                anchor("WALL_FACE", [0, 1.25, -1.5], [0, 0, 0], **plane(4, 2.5)),
                anchor("WALL_FACE", [2, 1.25, 0], [0, 270, 0], **plane(3, 2.5)),
                anchor("WALL_FACE", [-2, 1.25, 0], [0, 90, 0], **plane(3, 2.5)),
                anchor("DOOR_FRAME", [0, 1, -1.49], [0, 0, 0], **plane(1, 2)),
                anchor(
                    "STORAGE",
                    [0, 0.8, 1.25],
                    [270, 0, 0],
                    VolumeBounds={"Min": [-0.5, -0.25, -0.8], "Max": [0.5, 0.25, 0]},
                ),
                anchor("GLOBAL_MESH", [0, 0, 0], [0, 0, 0]),
            ]
        }
    ],
}


def entity(label, place, turn, **bounds):
    orientation, position = dict(zip("xyzw", turn, strict=True)), dict(zip("xyz", place, strict=True))
    return {
        "semanticLabel_META": label,
        "locatable_META": {"orientation": orientation, "position": position},
        **bounds,
    }


def rectangle(width, height):
    offset = {"x": -width / 2, "y": -height / 2}
    return {"bounded2D_META": {"offset": offset, "extent": {"width": width, "height": height}}}


# y up, and rectangles lie in x and z: those of walls stand after a quarter of a turn about x or z.
WEBXR = {
    "spatialEntities": [
        entity("FLOOR", [0, 0, 0], [0, 0, 0, 1], **rectangle(4, 3)),
        entity("CEILING", [0, 2.5, 0], [0, 0, 0, 1], **rectangle(4, 3)),
        entity("WALL_FACE", [0, 1.25, -1.5], [HALF, 0, 0, HALF], **rectangle(4, 2.5)),
        entity("WALL_FACE", [0, 1.25, 1.5], [HALF, 0, 0, HALF], **rectangle(4, 2.5)),
        entity("WALL_FACE", [2, 1.25, 0], [0, 0, HALF, HALF], **rectangle(2.5, 3)),
        entity("WALL_FACE", [-2, 1.25, 0], [0, 0, HALF, HALF], **rectangle(2.5, 3)),
        entity("DOOR_FRAME", [0, 1, 1.49], [HALF, 0, 0, HALF], **rectangle(1, 2)),
        entity(
            "STORAGE",
            [0, 0, -1.25],
            [0, 0, 0, 1],
            bounded3D_META={
                "offset": {"x": -0.5, "y": 0, "z": -0.25},
                "extent": {"width": 1, "height": 0.8, "depth": 0.5},
            },
        ),
        {"semanticLabel_META": "OTHER"},
    ]
}


def surface(place, right, size, **more):
    """A surface of RoomPlan: its pose column by column, x along `right`, y up."""
    up = [0, 1, 0]
    return {"transform": [*right, 0, *up, 0, *np.cross(right, up).tolist(), 0, *place, 1], "dimensions": size, **more}


# y up; no floor was found, and there never is a ceiling.
ROOMPLAN = {
    "version": 2,
    "walls": [
        surface([0, 1.25, -1.5], [1, 0, 0], [4, 2.5, 0]),
        surface([0, 1.25, 1.5], [1, 0, 0], [4, 2.5, 0]),
        surface([2, 1.25, 0], [0, 0, 1], [3, 2.5, 0]),
        surface(
            [-2, 1.25, 0],
            [0, 0, 1],
            [3, 2.5, 0],
            polygonCorners=[[-1.5, -1.25, 0], [1.5, -1.25, 0], [1.5, 1.25, 0], [-1.5, 1.25, 0]],
        ),
    ],
    "doors": [surface([0, 1, 1.5], [1, 0, 0], [1, 2, 0])],
    "objects": [surface([0, 0.4, -1.25], [1, 0, 0], [1, 0.8, 0.5], category={"storage": {}})],
}
ROOMS = {"MRUK": MRUK, "WebXR": WEBXR, "RoomPlan": ROOMPLAN}


@pytest.mark.parametrize("kind", ROOMS)
def test_what_was_captured_is_a_room(kind, write):
    path = write(json.dumps(ROOMS[kind]), "room.json")
    room = from_mesh(path, {"height": [0.5, 1.9], "clearance": 0.3}, 0.5)
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


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (
            {"version": 1},
            "it is no room of a headset or a phone that is known here (spatialEntities, Rooms, walls): it ",
        ),
        (MRUK | {"CoordinateSystem": "Unreal"}, "CoordinateSystem must be Unity, got 'Unreal': save the scene by MRUK"),
        (MRUK | {"Rooms": MRUK["Rooms"] * 2}, "it has 2 rooms: leave one of them in the file."),
        ({"spatialEntities": []}, "it has neither a floor nor walls."),
        ({"walls": [{"transform": [1.0], "dimensions": [4, 2.5, 0]}]}, "transform must be a list of 16 numbers"),
        ({"walls": [{"dimensions": [4, 2.5, 0]}]}, "the key or value 'transform' is missing or wrong."),
        ({"walls": 3}, "the key or value "),
        ([], "has no keys"),
        ("{", "cannot be read as JSON"),
    ],
)
def test_what_is_no_room_is_one_sentence(keys, message, write):
    path = write(keys if isinstance(keys, str) else json.dumps(keys), "room.json")
    with pytest.raises(InputError, match=rf"^path: .*{re.escape(message)}"):
        read_mesh(path)


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
