"""Rooms are read from levels of Open-RMF's buildings, in the frame of the level."""

import json

import pytest
import shapely

from lmd.core.checks import InputError
from lmd.formats.plans import read_plan_room

# A room of 6 x 4 m with a wall in it, at 0.02 m a pixel; y points down in the picture.
VERTICES = [[100, 100], [400, 100], [400, 300], [100, 300], [200, 100], [290, 100], [250, 300], [250, 200]]
LEVEL = {
    "vertices": [[x, y, 0, ""] for x, y in VERTICES],
    "walls": [[a, b, {}] for a, b in [(0, 4), (5, 1), (1, 2), (2, 6), (6, 3), (3, 0), (6, 7), (7, 7)]],
    "doors": [[4, 5, {"name": [1, "main"]}]],
    "measurements": [[0, 1, {"distance": [3, 5.9]}], [0, 3, {"distance": [3, 4.066666666666666]}]],
}
BUILDING = {"coordinate_system": "reference_image", "levels": {"L1": LEVEL}}


def room_of(folder, building, **more):
    path = folder / "lab.building.yaml"
    path.write_text(json.dumps(building))
    return read_plan_room(None, 2.5, {"height": [0.5, 1.0], "clearance": 0.2}, 0.5, path=str(path), **more)


@pytest.mark.parametrize("layers", [None, ["L1"]])
def test_a_level_with_a_door_and_a_wall_in_the_room(tmp_path, layers):
    room = room_of(tmp_path, BUILDING, layers=layers)
    expected = shapely.box(2.0, -6.0, 8.0, -2.0).difference(shapely.box(4.99, -6.0, 5.01, -3.99))
    assert shapely.hausdorff_distance(shapely.Polygon(room.plan.outline).boundary, expected.boundary) < 1e-3
    (door,), (corners,) = room.plan.keep_out, room.plan.kept_out
    assert door.name == "door"
    assert [corners[:, 0].min(), corners[:, 0].max()] == pytest.approx([4.0, 5.8], abs=0.07)


def test_metric_vertices_have_no_scale(tmp_path):
    level = LEVEL | {"measurements": []}
    room = room_of(tmp_path, {"coordinate_system": "cartesian_meters", "levels": {"L1": level}}, gap=0.0)
    assert shapely.Polygon(room.plan.outline).bounds == pytest.approx((100, 100, 400, 300), abs=1e-3)


@pytest.mark.parametrize(
    ("building", "expected"),
    [
        (BUILDING | {"coordinate_system": "wgs84"}, r"its coordinate_system is wgs84"),
        ({"levels": {"L1": LEVEL, "L2": LEVEL}}, r"^layers must name one level of .*, which has L1, L2"),
        ({"levels": {"L1": LEVEL | {"measurements": []}}}, r"it has no measurement, which gives the scale"),
        ({"levels": {"L1": LEVEL | {"walls": []}}}, r"its level L1 has no walls"),
        ({"levels": {"L1": LEVEL | {"walls": [[0, 99]]}}}, r"the key or value index 99 .* is missing or wrong"),
        ({"levels": {"L1": {"walls": []}}}, r"the key or value 'vertices' is missing or wrong"),
        ({"levels": {"L1": LEVEL | {"walls": LEVEL["walls"][:3]}}}, r"enclose no room"),
    ],
)
def test_bad_buildings_are_refused_in_a_sentence(tmp_path, building, expected):
    with pytest.raises(InputError, match=expected):
        room_of(tmp_path, building)


def test_another_level_keeps_the_frame_of_its_drawing(tmp_path):
    room = room_of(tmp_path, {"levels": {"L1": LEVEL, "L2": LEVEL}}, layers=["L2"])
    assert "coordinates are those of the drawing of L2, which fiducials may move" in room.plan.note
