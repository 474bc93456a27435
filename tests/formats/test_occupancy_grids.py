"""Occupancy grids are read as nav2_map_server reads them, and become rooms in the frame of the map."""

import math
from pathlib import Path

import numpy as np
import pytest
import shapely
import yaml
from contracts.space import check_space
from numpy.testing import assert_allclose, assert_array_equal
from occupancy_maps import FREE, KEYS, OCCUPIED, UNKNOWN, box, hall, write_map
from PIL import Image

from lmd.core.checks import InputError
from lmd.formats.occupancy_grid import occupancy, read_occupancy_grid
from lmd.formats.plans import read_plan_room
from lmd.scene.deployment_sources import RandomDeployment

REFUSED = yaml.safe_load(Path(__file__).with_name("files").joinpath("refused.yaml").read_text(encoding="utf-8"))


def room_of(path, height=2.5, reachable=None, spacing=0.5, **more):
    return read_plan_room(
        None, height, reachable or {"height": [0.5, 1.0], "clearance": 0.3}, spacing, path=path, **more
    )


# Grey values with occupied_thresh = 0.65 and free_thresh = 0.25. Without negate, 1 - g / 255 >= 0.65 for g <= 89.25 and
# 1 - g / 255 <= 0.25 for g >= 191.25; with negate g / 255 >= 0.65 for g >= 165.75 and g / 255 <= 0.25 for g <= 63.75.
# Between them, `scale` has (1 - g / 255 - 0.25) / 0.4 in per cent: 62.01 of 128.
GREY = [0, 89, 90, 128, 191, 192, 255]
EXPECTED = {
    ("trinary", False): [100, 100, -1, -1, -1, 0, 0],
    ("trinary", True): [0, -1, -1, -1, 100, 100, 100],
    ("scale", False): [100, 100, 99, 62, 0, 0, 0],
    ("scale", True): [0, 25, 26, 63, 100, 100, 100],
    ("raw", False): [0, 89, 90, -1, -1, -1, -1],
    ("raw", True): [0, 89, 90, -1, -1, -1, -1],
}


@pytest.mark.parametrize(("mode", "negate"), EXPECTED)
def test_cells_are_those_of_a_calculation_by_hand(mode, negate):
    grey, opaque = np.array([GREY], dtype=np.uint8), np.ones((1, 7), dtype=bool)
    assert_array_equal(occupancy(grey, opaque, mode, negate, 0.65, 0.25), [EXPECTED[mode, negate]])
    if mode != "raw":
        assert (occupancy(grey, ~opaque, mode, negate, 0.65, 0.25) == -1).all()


def test_thresholds_are_compared_in_single_precision():
    """The grey 205 has the occupancy 0.19608: unknown to the thresholds of gmapping, free to those of nav2."""
    grey, opaque = np.array([[205]], dtype=np.uint8), np.ones((1, 1), dtype=bool)
    assert occupancy(grey, opaque, "trinary", False, 0.65, 0.196) == -1
    assert occupancy(grey, opaque, "trinary", False, 0.65, 0.25) == 0
    assert occupancy(np.array([[0]]), opaque, "trinary", False, 1.0, 0.25) == 100


def pictures(folder):
    """One map in several kinds of pictures, by name."""
    grey = np.array([[0, 255], [255, 102]], dtype=np.uint8)
    palette = Image.fromarray(np.array([[0, 1], [1, 2]], dtype=np.uint8), "P")
    palette.putpalette([0, 0, 0, 255, 255, 255, 102, 102, 102])
    palette.save(folder / "palette.png")
    for name in ("grey.pgm", "grey.png", "grey.bmp"):
        Image.fromarray(grey).save(folder / name)
    Image.merge("RGB", [Image.fromarray(grey)] * 3).save(folder / "colour.png")
    Image.fromarray(grey.astype(np.uint16) * 257).save(folder / "deep.png")
    (folder / "ascii.pgm").write_text("P2\n# by hand\n2 2\n5\n0 5 5 2\n")
    (folder / "five.pgm").write_bytes(b"P5\n2 2\n5\n\x00\x05\x05\x02")
    return sorted(path.name for path in folder.iterdir())


def test_kinds_of_pictures_agree(tmp_path):
    names = pictures(tmp_path)
    assert len(names) == 8
    for name in names:
        (tmp_path / "map.yaml").write_text(yaml.safe_dump({**KEYS, "image": name, "mode": "Scale"}))
        assert_array_equal(read_occupancy_grid(tmp_path / "map.yaml").cells, [[0, 89], [100, 0]], err_msg=name)


def test_transparent_cells_are_unknown(tmp_path):
    grey = np.array([[FREE, 255], [FREE, 0]], dtype=np.uint8)
    Image.merge("LA", [Image.fromarray(np.full((2, 2), FREE, np.uint8)), Image.fromarray(grey)]).save(
        tmp_path / "a.png"
    )
    (tmp_path / "map.yaml").write_text(yaml.safe_dump({**KEYS, "image": "a.png"}))
    assert_array_equal(read_occupancy_grid(tmp_path / "map.yaml").cells, [[-1, -1], [-1, 0]])


def test_a_picture_of_another_machine_is_found_beside_its_yaml(tmp_path):
    path = write_map(tmp_path, hall(), image="/home/robot/maps/map.pgm")
    assert read_occupancy_grid(path).is_free.sum() == 120 * 80


@pytest.mark.parametrize("yaw", [0.0, 0.3, -2.0])
@pytest.mark.parametrize("mode", ["trinary", "scale"])
def test_the_room_is_in_the_frame_of_the_map(tmp_path, yaw, mode):
    grey = hall()
    box(grey, 2.0, 1.0, 2.6, 1.6, OCCUPIED)
    room = room_of(write_map(tmp_path, grey, mode=mode, origin=[-3.25, 7.5, yaw]), margin=0.1)
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    corners = np.array([[0, 0], [6, 0], [6, 4], [0, 4]]) + 0.5
    for ring, expected in (
        (room.plan.outline, corners),
        (room.plan.holes[0], np.array([[2, 1], [2.6, 1], [2.6, 1.6], [2, 1.6]]) + 0.5),
    ):
        expected = shapely.Polygon(expected @ turn.T + [-3.25, 7.5])
        assert shapely.Polygon(ring).symmetric_difference(expected).area < 1e-9
    assert len(room.surfaces()) == 8
    hung = RandomDeployment(50).draw(room, np.random.default_rng(0)).positions
    walls = shapely.Polygon(room.plan.outline, room.plan.holes).boundary
    assert shapely.distance(walls, shapely.points(hung[:, :2])).max() < 1e-3
    check_space(room_of(write_map(tmp_path, grey, origin=[0.1, 0.2, yaw]), spacing=1.5))


def test_walls_are_within_the_tolerance_of_the_contour(tmp_path):
    """Walls with noise of a cell on a map that is turned against its picture."""
    rng = np.random.default_rng(1)
    rows, columns = np.mgrid[0:260, 0:260]
    for angle in (0.0, 0.2, 0.7):
        x = 0.05 * ((columns - 130) * math.cos(angle) + (rows - 130) * math.sin(angle))
        y = 0.05 * ((rows - 130) * math.cos(angle) - (columns - 130) * math.sin(angle))
        noisy = np.maximum(np.abs(x) - 3.0, np.abs(y) - 2.0) + rng.uniform(-0.025, 0.025, x.shape)
        grey = np.where(noisy < 0.0, FREE, np.where(noisy < 0.2, OCCUPIED, UNKNOWN)).astype(np.uint8)
        room = room_of(write_map(tmp_path, grey, origin=[-6.5, -6.5, 0.0]), tolerance=0.1)
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        true = shapely.Polygon(np.array([[-3, -2], [3, -2], [3, 2], [-3, 2]]) @ turn.T + 0.025)
        found = shapely.Polygon(room.plan.outline)
        assert len(room.plan.outline) <= 8
        assert shapely.hausdorff_distance(found.boundary, true.boundary, 0.01) < 0.05
        assert abs(found.area / true.area - 1.0) < 0.02


def test_the_largest_free_region_is_the_room_and_others_are_named(tmp_path):
    grey = hall(8.0)
    box(grey, 5.0, 0.0, 5.1, 4.0, OCCUPIED)
    box(grey, 2.0, 2.0, 2.1, 2.1, OCCUPIED)  # noise
    path = write_map(tmp_path, grey)
    room = room_of(path)
    assert shapely.Polygon(room.plan.outline).bounds == pytest.approx((0, 0, 5, 4))
    assert not room.plan.holes
    told, start = room.plan.note.split("start = ")
    assert told.startswith(f"{path}: a free area of 11.6 m2 is left out")
    assert "1 groups of cells smaller than 0.2 m count as free" in start
    other = room_of(path, start=yaml.safe_load(start[: start.index("]") + 1]), speck=0.05)
    assert shapely.Polygon(other.plan.outline).bounds == pytest.approx((5.1, 0, 8, 4))
    assert len(room_of(path, speck=0.05).plan.holes) == 1


def test_rays_through_a_gap_are_left_out_and_doors_are_not(tmp_path):
    grey = hall()
    box(grey, 6.0, 1.0, 6.5, 1.15, FREE)  # through a window
    assert shapely.Polygon(room_of(write_map(tmp_path, grey)).plan.outline).bounds[2] < 6.2
    assert shapely.Polygon(room_of(write_map(tmp_path, grey), passage=0.1).plan.outline).bounds[2] > 6.4
    box(grey, 3.0, 0.0, 3.1, 4.0, OCCUPIED)
    box(grey, 3.0, 1.0, 3.1, 1.8, FREE)
    assert shapely.Polygon(room_of(write_map(tmp_path, grey)).plan.outline).area == pytest.approx(24 - 0.32, abs=0.2)


def test_nothing_hangs_where_the_map_has_no_wall(tmp_path):
    grey = hall()
    box(grey, 5.9, -0.1, 6.2, 4.1, UNKNOWN)  # the eastern wall was never seen
    box(grey, 1.0, -0.1, 2.5, 0.0, UNKNOWN)  # 1.5 m of the southern wall were never seen
    room = room_of(write_map(tmp_path, grey))
    for surface in room.surfaces():
        a, b = (surface.point(at, 1.0) for at in (0.0, surface.extent[0]))
        assert min(a[0], b[0]) < 5.8, "the eastern edge carries landmarks"
        if abs(a[1]) < 0.01 and abs(b[1]) < 0.01:
            bounds = np.array([part.bounds for part in shapely.get_parts(surface.allowed)])
            assert_allclose(np.sort(bounds[:, [0, 2]], axis=0), [[0.0, 1.15], [2.35, 5.9]], atol=0.1)
    assert sum(surface.is_upright for surface in room.surfaces()) == 3


def test_grey_that_a_map_saver_writes_for_unknown_cells_is_unknown(tmp_path):
    path = write_map(tmp_path, hall(), free_thresh=0.25)
    assert (read_occupancy_grid(path).cells == 0).sum() > 120 * 80  # as nav2 reads it
    room = room_of(path)
    assert shapely.Polygon(room.plan.outline).area == pytest.approx(24.0)
    assert "free_thresh = 0.25 makes nav2 drive over the grey 205" in room.plan.note


def test_pillars_that_touch_by_a_corner_are_one(tmp_path):
    grey = hall()
    for i in range(6):
        box(grey, 2.0 + 0.3 * i, 1.0 + 0.3 * i, 2.3 + 0.3 * i, 1.3 + 0.3 * i, OCCUPIED)
    box(grey, 0.0, 2.0, 0.3, 2.3, OCCUPIED)
    box(grey, 0.3, 2.3, 0.6, 2.6, OCCUPIED)
    room = room_of(write_map(tmp_path, grey), tolerance=0.01)
    assert len(room.plan.holes) == 1
    assert shapely.Polygon(room.plan.outline, room.plan.holes).area == pytest.approx(24 - 8 * 0.09, abs=0.02)


@pytest.mark.parametrize("row", REFUSED["occupancy_grid"], ids=lambda row: row["words"])
def test_bad_input_is_refused_in_a_sentence(tmp_path, row):
    path = write_map(tmp_path, hall(), **row.get("keys", {}))
    arguments = {"outline": None, "height": 2.5, **row.get("more", {})}
    with pytest.raises(InputError, match=row["words"]) as error:
        read_plan_room(reachable={"height": [0.5, 1.0]}, spacing=0.5, path=path, **arguments)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("row", REFUSED["floor_plan"], ids=lambda row: row["words"])
def test_another_file_is_refused_in_a_sentence(tmp_path, row):
    if "text" in row:
        (tmp_path / row["name"]).write_text(row["text"])
    with pytest.raises(InputError, match=rf"^(path: .*|){row['words']}"):
        room_of(str(tmp_path / row["name"]))


def test_a_picture_that_is_cut_short_or_not_there_is_refused(tmp_path):
    path = write_map(tmp_path, hall())
    content = (tmp_path / "map.pgm").read_bytes()
    for damaged, expected in (
        (content[:300], "cannot be read as a picture"),
        (b"", "it is empty"),
        (b"version https://git-lfs.github.com/spec/v1\n", "`git lfs pull` fetches the picture"),
    ):
        (tmp_path / "map.pgm").write_bytes(damaged)
        with pytest.raises(InputError, match=expected):
            room_of(path)
