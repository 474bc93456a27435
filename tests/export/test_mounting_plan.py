"""The plan is measured on its rendered pages."""

import itertools

import cv2
import numpy as np
import pypdfium2
import pytest
import trimesh
from support import rooms
from support.tables import rows

from lmd.export.paper import PAPERS
from lmd.export.plan import View, write_plan
from lmd.formats.meshes import read_mesh_room
from lmd.formats.tag_map import TagMap
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import UniformDeployment
from lmd.scene.footprints import Footprints
from lmd.scene.labels import Labels
from lmd.scene.tag import Tag
from lmd.space.cuboid import Cuboid
from lmd.space.floor_plan import FloorPlan

ROOM = Cuboid((6.0, 4.0, 2.8), (5.0, 3.0, 1.2), 0.5)
TAG = Tag(0.2)
PIXELS = 20  # a mm
LIGHT = 217  # of the black squares on the plan
SEEN = rows(__file__, "tags by hand")  # place in the room, and from the left and from below, mm
# An obstacle that hangs in the room, so that all of its faces are seen.
FACES = {"low": [4, 0.5, 0.5], "high": [5, 1.5, 1.5], "faces": ["x_min", "x_max", "y_min", "y_max", "bottom", "top"]}


def one_tag(name):
    (surface,) = [surface for surface in ROOM.surfaces() if surface.name == name]
    position = np.array([SEEN[name][0]])
    return Deployment(position, surface.normal[None], labels=Labels(np.array([23]))).with_surfaces(ROOM)


def written(path, deployment, paper="a4", tag=TAG):
    """The pages after the first."""
    write_plan(path, TagMap(ROOM, tag, deployment), paper)
    return list(pypdfium2.PdfDocument(path))[1:]


def solid(mask, size):
    """Where a square of this size is all True."""
    return cv2.erode(mask.astype(np.uint8), np.ones((size, size), np.uint8))


def sides(picture):
    """The rows and columns of the outline, which alone is so thick and so long."""
    outline = solid(picture < 100, 4)
    return [np.flatnonzero(outline.sum(axis=axis) > 0.9 * outline.sum(axis=axis).max()) for axis in (1, 0)]


def words(page):
    return " ".join(page.get_textpage().get_text_range().split())


@pytest.mark.parametrize("paper", ["a4", "letter"])
@pytest.mark.parametrize("name", SEEN)
def test_a_tag_is_drawn_and_listed_where_it_is_seen(name, paper, tmp_path):
    (page,) = written(tmp_path / "plan.pdf", one_tag(name), paper)
    across, up = SEEN[name][1]
    assert f"23 {across} {up} {across - 125} {up - 125}" in words(page)
    assert words(page).startswith(f"{name}, seen from")
    assert page.get_size() == pytest.approx([length * 72 / 25.4 for length in PAPERS[paper][::-1]])
    picture = np.array(page.render(scale=PIXELS / 72 * 25.4, grayscale=True).to_pil())
    scale = int(words(page).partition("scale 1 : ")[2].partition(";")[0])
    rows, columns = sides(picture)
    square = solid(picture == LIGHT, 12)  # only the black square of the tag is so large and so grey
    down, right = np.nonzero(square)
    middle = np.array([(right.min() + right.max()) / 2 - columns.min(), rows.max() - (down.min() + down.max()) / 2])
    np.testing.assert_allclose(middle / PIXELS * scale, [across, up], atol=0.3 * scale)
    assert (np.ptp(right) + 11) / PIXELS * scale == pytest.approx(200.0, abs=0.3 * scale)
    (surface,) = [surface for surface in ROOM.surfaces() if surface.name == name]
    size = np.ptp(columns), np.ptp(rows)
    np.testing.assert_allclose(np.divide(size, PIXELS) * scale, 1000 * np.array(surface.extent), atol=0.5 * scale)


def test_where_nothing_may_hang_is_grey(tmp_path):
    room = rooms.lab()
    (wall,) = [surface for surface in room.surfaces() if surface.name == "wall_0"]
    tag = Deployment(wall.point(3.0, 1.5)[None], wall.normal[None]).with_surfaces(room)
    write_plan(tmp_path / "plan.pdf", TagMap(room, TAG, tag), "a4")
    _, page = pypdfium2.PdfDocument(tmp_path / "plan.pdf")
    assert "nothing hangs where it is grey" in words(page)
    picture = np.array(page.render(scale=PIXELS / 72 * 25.4, grayscale=True).to_pil())
    rows, columns = sides(picture)
    size = np.array([np.ptp(columns), np.ptp(rows)]) / [6.0, 2.5]  # pixels a metre

    def grey(x, z):
        """By hand: whoever stands before this wall has x to the left."""
        across, up = np.round(size * [6.0 - x, z]).astype(int)
        return bool(picture[rows.max() - up, columns.min() + across] < 250)

    # The door is from x = 4.5 to 5.5 m up to 2 m, and people reach from 0.25 to 2.25 m.
    assert all(grey(*at) for at in ((4.6, 0.3), (5.45, 1.7), (5.4, 2.4), (1.0, 0.2)))
    assert not any(grey(*at) for at in ((4.4, 0.3), (5.6, 1.9), (5.4, 2.1), (1.0, 0.3)))


def test_every_tag_is_in_one_table_even_where_they_go_on_another_page(tmp_path):
    deployment = UniformDeployment(300).draw(ROOM, np.random.default_rng(0))
    pages = written(tmp_path / "plan.pdf", deployment, tag=Tag(0.05))
    order = TagMap(ROOM, TAG, deployment).order.tolist()
    assert len(pages) == 12  # 50 on each of six surfaces, 30 on a page
    text = [words(page) for page in pages]
    for index, surface in enumerate(ROOM.surfaces()):
        view = View(surface)
        own = " ".join(page for page in text if page.startswith(f"{surface.name},"))
        for number in np.flatnonzero(deployment.surfaces == index):
            across, up = 1000 * view.place(deployment.positions[number])
            place = order.index(number) + 1
            assert f" {place} {number} {across:.0f} {up:.0f} " in own


def test_tags_near_a_surface_belong_to_it_and_others_are_listed_apart(tmp_path):
    positions, normals = np.array([[0.03, 1.0, 1.2], [3.0, 2.0, 1.0]]), np.array([[1.0, 0.0, 0.0]] * 2)
    near, free = written(tmp_path / "plan.pdf", Deployment(positions, normals).with_surfaces(ROOM))
    assert words(near).startswith("x_min, seen from the front")
    assert "0 1000 1200 875 1075" in words(near)
    assert words(free).startswith("free in the room on no surface, tags: 1;")
    assert "2 1 3000 2000 1000" in words(free)


def lab():
    """A room with a door, a window, a table and something without a name, and two tags on each of its walls."""
    room = rooms.lab(
        keep_out=[
            rooms.DOOR,
            {"name": "big window", "surface": "wall_5", "from_left": [1, 2], "from_below": [1, 2]},
            {"surface": "wall_1", "from_left": [0.5, 1], "from_below": [1, 2]},
        ],
        obstacles=[{**rooms.RACK, "name": "rack", "faces": []}],
        surfaces=[f"wall_{i}" for i in range(6)],
    )
    source = UniformDeployment(16)
    return TagMap(room, Tag(0.1), Footprints(room, Tag(0.1)).draw(source, np.random.default_rng(0)))


def test_tags_are_hung_from_the_left_around_the_room():
    tags = lab()
    names = [tags.room.surfaces()[index].name for index in tags.route]
    assert names == ["wall_0", "wall_5", "wall_4", "wall_3", "wall_2", "wall_1"]  # clockwise, seen from above
    assert sorted(tags.order.tolist()) == list(range(len(tags.ids)))
    ends = []
    for index, places in tags.tags_by_surface.items():
        own, view = tags.order[places], View(tags.room.surfaces()[index])
        left = view.place(tags.deployment.positions[own])
        assert (np.diff(left[:, 0]) > -1e-9).all()
        assert (np.diff(left[:, 1])[np.diff(left[:, 0]) < 1e-9] > 0.0).all()
        ends.append((view.corner(right=False, top=False), view.corner(right=True, top=False)))
    for (_, right), (left, _) in itertools.pairwise(ends):
        np.testing.assert_allclose(left, right, atol=1e-9)  # where one wall ends, the next begins


def test_the_first_page_names_walls_and_fixtures_and_says_where_each_is_hung(tmp_path):
    tags = lab()
    write_plan(tmp_path / "plan.pdf", tags, "a4")
    first, *others = (words(page) for page in pypdfium2.PdfDocument(tmp_path / "plan.pdf"))
    assert first.startswith("16 tags of 36h11, 100 mm (black square) seen from above")
    for name in ("door", "big window", "rack", "keep_out 2", "furniture", "other"):
        assert name in first
    for index, places in tags.tags_by_surface.items():
        name, numbers = tags.names[index], f"{places[0] + 1} to {places[-1] + 1}"
        assert f"{name}: no. {numbers}" in first  # at the wall
        (page,) = [number for number, text in enumerate(others, 2) if text.startswith(f"{name}, seen from the front")]
        assert f"{numbers} {name} {len(places)} {page}" in first  # in the table
    for name, fixture in (("wall_0", "door"), ("wall_5", "big window"), ("wall_5", "rack"), ("wall_1", "keep_out 2")):
        (text,) = [text for text in others if text.startswith(f"{name},")]
        assert fixture in text


def test_heights_are_from_the_floor_even_where_it_is_not_the_lowest_point(tmp_path):
    plan = FloorPlan(rooms.L_SHAPE, 2.5, obstacles=[{"low": [1, 1, 1], "high": [2, 2, 1.5]}])
    scene = trimesh.load_scene(rooms.written(tmp_path / "lab.glb", plan))
    scene.add_geometry(trimesh.creation.box(bounds=[(4, 0.5, -1), (5, 1.5, -0.5)]), node_name="pit")
    scene.add_geometry(trimesh.creation.box(bounds=[(-0.5, -0.5, 2.5), (6.5, 4.5, 2.6)]), node_name="roof")
    scene.export(tmp_path / "pit.glb")
    room = read_mesh_room(str(tmp_path / "pit.glb"), {"height": [0.5, 1.5], "clearance": 0.25}, 0.5, up="z")
    assert room.bounds()[0][2] == -1.0
    side = next(surface for surface in room.surfaces() if surface.name.startswith("box_0") and surface.normal[0] < -0.9)
    tag = Deployment(side.point(0.5, 0.25)[None], side.normal[None]).with_surfaces(room)
    write_plan(tmp_path / "plan.pdf", TagMap(room, TAG, tag), "a4")
    _, page = pypdfium2.PdfDocument(tmp_path / "plan.pdf")
    assert "1 0 500 1250 375 1125" in words(page)  # 250 mm above the lower edge of the box, which hangs at 1 m


def test_names_in_other_letters_are_written_and_long_ones_shortened(tmp_path):
    door, rack = {**rooms.DOOR, "name": "dve\u0159e"}, {**rooms.RACK, "name": 50 * "rack "}
    room = rooms.lab(keep_out=[door], obstacles=[rack])
    (wall,) = [surface for surface in room.surfaces() if surface.name == "wall_0"]
    tag = Deployment(wall.point(3.0, 1.5)[None], wall.normal[None]).with_surfaces(room)
    for name in ("one", "two"):
        write_plan(tmp_path / name, TagMap(room, TAG, tag), "a4")
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
    first, page = (words(page) for page in pypdfium2.PdfDocument(tmp_path / "one"))
    assert "dve\u0159e" in first
    assert "dve\u0159e" in page
    assert "rack rack rack rack rac\u2026" in first


def test_the_plan_says_how_large_each_tag_is_where_they_differ(tmp_path):
    tag = Tag(0.1, edges=(0.06, 0.1, 0.3))
    deployment = UniformDeployment(6, "by_area").draw(ROOM, np.random.default_rng(0), tag)
    write_plan(tmp_path / "plan.pdf", TagMap(ROOM, tag, deployment), "a4")
    first, *others = (words(page) for page in pypdfium2.PdfDocument(tmp_path / "plan.pdf"))
    assert first.startswith("6 tags of 36h11, 60, 100, 300 mm (black square)")
    for number, edge in zip(deployment.ids.tolist(), deployment.edges.tolist(), strict=True):
        assert any(f" {number} {1000 * edge:.0f} " in text for text in others)
    with_free = Deployment(deployment.positions * 0.8 + 0.5, deployment.normals, edges=deployment.edges)
    write_plan(tmp_path / "free.pdf", TagMap(ROOM, tag, with_free), "a4")
    *_, last = pypdfium2.PdfDocument(tmp_path / "free.pdf")
    assert "edge," in words(last)
