"""Occupancy grids are read as nav2_map_server reads them, and become rooms in the frame of the map."""

from pathlib import Path

import numpy as np
import pytest
import shapely
import yaml
from numpy.testing import assert_array_equal
from PIL import Image
from support.rooms import FREE, KEYS, hall, write_map
from support.tables import rows

from lmd.core.checks import InputError
from lmd.formats.plans import occupancy, read_occupancy_grid, read_plan_room

REFUSED = yaml.safe_load(Path(__file__).with_name("files").joinpath("refused.yaml").read_text(encoding="utf-8"))


def room_of(path, height=2.5, reachable=None, spacing=0.5, **more):
    return read_plan_room(
        None, height, reachable or {"height": [0.5, 1.0], "clearance": 0.3}, spacing, path=path, **more
    )


# Grey values with occupied_thresh = 0.65 and free_thresh = 0.25. Without negate, 1 - g / 255 >= 0.65 for g <= 89.25 and
# 1 - g / 255 <= 0.25 for g >= 191.25; with negate g / 255 >= 0.65 for g >= 165.75 and g / 255 <= 0.25 for g <= 63.75.
# Between them, `scale` has (1 - g / 255 - 0.25) / 0.4 in per cent: 62.01 of 128.
GREY = [0, 89, 90, 128, 191, 192, 255]


@pytest.mark.parametrize(("mode", "negate", "expected"), rows(__file__, "occupancy by hand"))
def test_cells_are_those_of_a_calculation_by_hand(mode, negate, expected):
    grey, opaque = np.array([GREY], dtype=np.uint8), np.ones((1, 7), dtype=bool)
    assert_array_equal(occupancy(grey, opaque, mode, negate, 0.65, 0.25), [expected])
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


def test_grey_that_a_map_saver_writes_for_unknown_cells_is_unknown(tmp_path):
    path = write_map(tmp_path, hall(), free_thresh=0.25)
    assert (read_occupancy_grid(path).cells == 0).sum() > 120 * 80  # as nav2 reads it
    room = room_of(path)
    assert shapely.Polygon(room.plan.outline).area == pytest.approx(24.0)
    assert "free_thresh = 0.25 makes nav2 drive over the grey 205" in room.plan.note


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
