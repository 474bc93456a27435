"""Curved walls of RoomPlan's, with areas worked out by hand."""

import json
import math

import numpy as np
import pytest
from captured import curve, room_of_walls

from lmd.core.checks import InputError
from lmd.formats.meshes import read_mesh, read_mesh_room


def floor_of(write, keys):
    mesh = read_mesh(write(json.dumps(keys), "room.json"))
    corners = mesh.vertices[mesh.faces[mesh.of == mesh.names.index("floor_0")]]
    return np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]).sum() / 2.0


HALF_CIRCLE = 24.0 + 2.0 * math.pi  # beyond a wall of 4 m
# Beyond a chord of 4 m, with radius 2.5: 3 and 4 are to 5 as half the chord and 1.5 to 2 and 2.5.
ANGLE = math.degrees(math.asin(2.0 / 2.5))
SEGMENT = 2.5**2 * math.radians(ANGLE) - 2.0 * 1.5


@pytest.mark.parametrize(
    ("given", "area"),
    [
        (curve(2.0, 0.0, 180.0, [0.0, 0.0]), HALF_CIRCLE),
        (curve(2.0, 180.0, 0.0, [0.0, 0.0]), HALF_CIRCLE),
        (curve(2.0, 0.0, math.pi, [0.0, 0.0], 180.0 / math.pi), HALF_CIRCLE),  # rad
        (curve(2.0, 0.0, 180.0), HALF_CIRCLE),  # as iOS 16 has it
        (curve(2.5, 270.0 - ANGLE, 270.0 + ANGLE, [0.0, 1.5]), 24.0 + SEGMENT),
        (curve(2.5, 90.0 - ANGLE, 90.0 + ANGLE, [0.0, 1.5]), 24.0 + SEGMENT),
        (None, 24.0),
    ],
)
def test_the_floor_reaches_to_the_arc(given, area, write):
    assert floor_of(write, room_of_walls(None, given)) == pytest.approx(area, abs=0.01)


def test_an_arc_may_bend_into_the_room_of_walls(write):
    """By its middle, which lies beyond the wall; the hull of all walls is then that of the flat ones."""
    inward = room_of_walls(None, curve(2.5, 90.0 - ANGLE, 90.0 + ANGLE, [0.0, -1.5]))
    mesh = read_mesh(write(json.dumps(inward), "room.json"))
    own = mesh.vertices[np.unique(mesh.faces[mesh.of == mesh.names.index("wall_1")])]
    assert own[:, 0].min() == pytest.approx(5.0, abs=0.01)
    assert own[:, 0].max() == pytest.approx(6.0)


def test_strips_are_within_a_centimetre_of_the_arc(write):
    mesh = read_mesh(write(json.dumps(room_of_walls(None, curve(2.0, 0.0, 180.0, [0.0, 0.0]))), "room.json"))
    own = mesh.vertices[mesh.faces[mesh.of == mesh.names.index("wall_1")]]
    points = np.concatenate([own, (own + np.roll(own, 1, axis=1)) / 2.0], axis=1).reshape(-1, 3)
    assert np.abs(np.hypot(points[:, 0] - 6.0, points[:, 1] + 2.0) - 2.0).max() < 0.01
    assert "curved walls are made of flat strips" in mesh.note
    assert not read_mesh(write(json.dumps(room_of_walls()), "flat.json")).note


def test_tags_hang_on_strips_and_no_camera_is_beyond_them(write):
    path = write(json.dumps(room_of_walls(None, curve(2.0, 0.0, 180.0, [0.0, 0.0]))), "room.json")
    built = read_mesh_room(path, {"height": [0.5, 1.9], "clearance": 0.3}, 0.5)
    assert sum(s.area for s in built.surfaces() if s.name.startswith("wall_1")) == pytest.approx(
        2.0 * math.pi * 2.5, rel=0.01
    )
    beyond = built.grid()[built.grid()[:, 0] > 6.0]
    assert len(beyond)
    assert (np.hypot(beyond[:, 0] - 6.0, beyond[:, 1] + 2.0) < 1.72).all()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (curve(2.0, 0.0, math.pi, [0.0, 0.0]), "walls[1].curve ends 4 m"),  # rad, taken for degrees
        (curve(2.0, 0.0, 180.0, [3.0, 0.0]), "contradict the dimensions; with curve = null it is read as flat."),
        (curve(-2.0, 0.0, 180.0), "walls[1].curve.radius must be greater than 0"),
        (curve(2.0, 0.0, 10**400), "walls[1].curve.endAngle must be finite"),
        (curve(2.0, 90.0, 90.0), "an arc has more than no angle and at most one turn"),
        (curve(2.0, 0.0, 180.0, [0.0]), "walls[1].curve.center must be a list of 2 numbers"),
        ({"radius": 1.0}, "walls[1].curve must have radius, startAngle and endAngle"),
        ([1.0], "walls[1].curve must have radius, startAngle and endAngle"),
        ({"radius": 2.0, "startAngle": [], "endAngle": {}}, "walls[1].curve.startAngle must be a number"),
    ],
)
def test_an_arc_that_cannot_be_is_refused(given, message, write):
    with pytest.raises(InputError) as told:
        read_mesh(write(json.dumps(room_of_walls(None, given)), "room.json"))
    assert message in str(told.value)
