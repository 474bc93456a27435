"""Rooms are read from drawings in DXF, in their frame."""

from pathlib import Path

import numpy as np
import pytest
import shapely
import yaml
from support.tables import rows

from lmd.core.checks import InputError
from lmd.formats.plans import EXAMPLE, read_plan_room

ezdxf = pytest.importorskip("ezdxf")
REFUSED = yaml.safe_load(Path(__file__).with_name("files").joinpath("refused.yaml").read_text(encoding="utf-8"))
WALL = {"layer": "A-WALL"}
EAST = np.array(
    [
        *[(1900, 0), (8000, 0), (8000, 5000), (3900, 5000), (3900, 4800), (5000, 4800), (5000, 3000), (5100, 3000)],
        *[(5100, 4800), (7800, 4800), (7800, 200), (5100, 200), (5100, 2100), (5000, 2100), (5000, 200), (1900, 200)],
    ]
)


def room_of(path, **more):
    arguments = {"height": 2.5, "reachable": {"height": [0.5, 1.0], "clearance": 0.2}, "spacing": 0.5, **more}
    return read_plan_room(path=str(path), tolerance=0.01, **arguments)


@pytest.fixture
def draw(tmp_path):
    """A function that saves a drawing, which a function of its modelspace fills, and returns its path."""

    def saved(fill, units=4, name="plan.dxf"):
        document = ezdxf.new(units=units)
        document.blocks.new("DOOR90").add_arc((0, 0), 900, 0, 90)
        fill(document.modelspace())
        document.saveas(tmp_path / name)
        return tmp_path / name

    return saved


def flat(space):
    """Two rooms with walls of 0.2 m: a door of 0.9 m to the south, a window to the north, 0.9 m between the rooms."""
    for ring in (
        [(0, 0), (1000, 0), (1000, 200), (200, 200), (200, 4800), (1500, 4800), (1500, 5000), (0, 5000)],
        EAST,
        [(3000, 2000), (3400, 2000), (3400, 2400), (3000, 2400)],  # a pillar
    ):
        space.add_lwpolyline(ring, close=True, dxfattribs=WALL)
    for y in (4800, 5000):
        space.add_line((1500, y), (3900, y), dxfattribs={"layer": "A-WINDOW"})
    space.add_blockref("DOOR90", (1000, 200), dxfattribs=WALL)
    space.add_line((200, 3500), (1200, 3500), dxfattribs=WALL)  # a partition
    space.add_lwpolyline([(3500, 500), (4500, 500), (4500, 1500)], close=True, dxfattribs={"layer": "FURNITURE"})


def test_doors_windows_pillars_and_partitions(draw):
    plan = room_of(draw(flat)).plan
    partition, pillar = shapely.box(0.2, 3.49, 1.21, 3.51), shapely.box(3.0, 2.0, 3.4, 2.4)
    expected = shapely.box(0.2, 0.2, 5.0, 4.8).difference(pillar | partition)
    assert shapely.Polygon(plan.outline, plan.holes).symmetric_difference(expected).area < 1e-3
    assert "walls are the lines of A-WALL, without those of FURNITURE (1)" in plan.note
    assert "2.4 m2 is left out: start = [" in plan.note
    east = shapely.Polygon(room_of(draw(flat), start=[6.0, 3.0]).plan.outline)
    assert east.bounds == pytest.approx((5.1, 0.2, 7.8, 4.8), abs=1e-3)


@pytest.mark.parametrize(("code", "unit", "scale"), [(1, "inches", 0.0254), (2, "feet", 0.3048), (6, "metres", 1.0)])
def test_the_unit_is_that_of_the_drawing_or_asked_for(draw, code, unit, scale):
    size = [6.0 / scale, 4.0 / scale]
    corners = [(0, 0), (size[0], 0), size, (0, size[1])]
    path = draw(lambda space: space.add_lwpolyline(corners, close=True), code)
    assert shapely.Polygon(room_of(path).plan.outline).bounds == pytest.approx((0, 0, 6, 4), abs=1e-3)
    path = draw(lambda space: space.add_lwpolyline(corners, close=True), 0)
    with pytest.raises(InputError, match=rf"^unit must be given, as '.*plan\.dxf' states none.*{unit} make 6 x 4 m"):
        room_of(path)
    assert shapely.Polygon(room_of(path, unit=unit).plan.outline).area == pytest.approx(24.0, abs=0.01)


def test_single_lines_with_a_gap_and_curves(draw):
    def fill(space):
        space.add_arc((3000, 4000), 3000, 0, 180)
        for start, end in (((0, 4000), (0, 0)), ((0, 0), (2000, 0)), ((2900, 0), (6000, 0)), ((6000, 0), (6000, 4000))):
            space.add_line(start, end)
        space.add_circle((3000, 3000), 300)
        space.add_polymesh((3, 3))  # no line

    room = room_of(draw(fill))
    area = 24.0 + np.pi * 9.0 / 2.0 - np.pi * 0.09
    assert shapely.Polygon(room.plan.outline, room.plan.holes).area == pytest.approx(area, rel=0.01)
    assert len(room.plan.holes) == 1
    assert [part.name for part in room.plan.keep_out] == ["opening"]


@pytest.mark.parametrize("head", ["", "0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1009\n0\nENDSEC\n"])
def test_a_polyline_without_marks_of_subclasses(tmp_path, head, caplog):
    caplog.set_level("INFO")
    places = "".join(f"10\n{x}\n20\n{y}\n" for x, y in [(0, 0), (6, 0), (6, 4), (0, 4)])
    line = f"0\nLWPOLYLINE\n8\nWALLS\n90\n4\n70\n1\n{places}"
    (tmp_path / "plan.dxf").write_text(f"{head}0\nSECTION\n2\nENTITIES\n{line}0\nENDSEC\n0\nEOF\n")
    assert len(room_of(tmp_path / "plan.dxf", unit="metres").plan.outline) == 4
    assert not caplog.records  # of repairs, which would begin a log of a refused run


@pytest.mark.parametrize("row", REFUSED["drawing"], ids=lambda row: row["words"])
def test_bad_settings_are_refused_in_a_sentence(draw, row):
    with pytest.raises(InputError, match=row["words"]):
        room_of(draw(flat), **row["more"])


def test_a_drawing_whose_layers_do_not_name_walls_asks_for_them(draw):
    def fill(space):
        space.add_lwpolyline([(0, 0), (6, 0), (6, 4), (0, 4)], close=True, dxfattribs={"layer": "1"})
        space.add_line((1, 1), (2, 2), dxfattribs={"layer": "2"})

    path = draw(fill, 6)
    with pytest.raises(
        InputError, match=r"^layers must name the layers with the walls; .* has 1 \(1 lines\), 2 \(1 lines\)"
    ):
        room_of(path)
    assert len(room_of(path, layers=["1"]).plan.outline) == 4


@pytest.mark.parametrize(("within", "on", "more", "area"), rows(__file__, "layers that are not shown"))
def test_a_wall_that_a_cad_program_does_not_show_is_none(tmp_path, within, on, more, area):
    document = ezdxf.new(units=6)
    document.layers.add("WALL_OFF").off()
    document.layers.add("WALL_FROZEN").freeze()
    document.layers.add("PLAIN", plot=False)
    space = document.modelspace()
    space.add_lwpolyline([(0, 0), (6, 0), (6, 4), (0, 4)], close=True, dxfattribs={"layer": "WALLS"})
    block, outer = document.blocks.new("OLD"), document.blocks.new("OUTER")
    to = space if within is None else block
    if more.pop("paperspace", 0):
        to = document.paperspace()
    to.add_line((3, 0), (3, 4), dxfattribs={"layer": on, **more} if within is None else {"layer": within})
    if within is not None:
        outer.add_blockref("OLD", (0, 0))  # on layer 0, which is that of the outer block
        space.add_blockref("OUTER", (0, 0), dxfattribs={"layer": on, **more})
    document.saveas(tmp_path / "plan.dxf")
    room = room_of(tmp_path / "plan.dxf", layers=["WALLS", "PLAIN"][: 1 + (on == "PLAIN")])
    assert shapely.Polygon(room.plan.outline).area == pytest.approx(area, abs=0.01)
    if area == 24.0 and "WALL_OFF" in (within, on):
        assert "does not show" in room_of(tmp_path / "plan.dxf").plan.note
        with pytest.raises(InputError, match=r"^layers: 'wall_off' of '.*' has only what a CAD program does not show"):
            room_of(tmp_path / "plan.dxf", layers=["WALLS", "wall_off"])


def test_a_drawing_takes_the_place_of_the_example(draw):
    from omegaconf import OmegaConf
    from support.composing import composed

    from pipelines.nodes import instantiate

    node = OmegaConf.to_container(composed("optimise", "room=floor_plan").room, resolve=True)
    assert {name: node[name] for name in EXAMPLE} == EXAMPLE
    assert len(instantiate(composed("optimise", "room=floor_plan").room).plan.outline) == 6
    own = "room.keep_out=[{surface: wall_3, from_left: [4, 4.5], from_below: [0, 1], name: screen}]"
    cfg = composed("optimise", "room=floor_plan", f"room.path={draw(flat)}", "room.spacing=1", own)
    room = instantiate(cfg.room)
    assert {part.name for part in room.plan.keep_out} == {"door", "window", "opening", "screen"}
