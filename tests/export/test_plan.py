"""The plan is measured on its rendered pages."""

import cv2
import floor_plans
import numpy as np
import pypdfium2
import pytest

from lmd.deployment import Deployment, UniformDeployment
from lmd.export.paper import PAPERS
from lmd.export.plan import View, write_plan
from lmd.export.tag_map import TagMap
from lmd.labels import Labels
from lmd.space.cuboid import Cuboid
from lmd.tag import Tag, upright

ROOM = Cuboid((6.0, 4.0, 2.8), (5.0, 3.0, 1.2), 0.5)
TAG = Tag(0.2)
PIXELS = 20  # a mm
LIGHT = 217  # of the black squares on the plan
# By hand, for whoever stands before the surface: where the tag is, and where it is from the left and from below, mm.
SEEN = {
    "x_min": ((0.0, 1.0, 1.2), (1000, 1200)),
    "x_max": ((6.0, 1.0, 1.2), (3000, 1200)),
    "y_min": ((2.0, 0.0, 0.7), (4000, 700)),
    "y_max": ((2.0, 4.0, 0.7), (2000, 700)),
    "floor": ((2.0, 1.0, 0.0), (2000, 1000)),
    "ceiling": ((2.0, 1.0, 2.8), (4000, 1000)),
}
# An obstacle that hangs in the room, so that all of its faces are seen.
FACES = {"low": [4, 0.5, 0.5], "high": [5, 1.5, 1.5], "faces": ["x_min", "x_max", "y_min", "y_max", "bottom", "top"]}


def one_tag(name):
    (surface,) = [surface for surface in ROOM.surfaces() if surface.name == name]
    position = np.array([SEEN[name][0]])
    return Deployment(position, surface.normal[None], labels=Labels(np.array([23]))).hung(ROOM)


def written(path, deployment, paper="a4", tag=TAG):
    write_plan(path, TagMap(ROOM, tag, deployment), paper)
    return list(pypdfium2.PdfDocument(path))


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
    square = solid(picture == LIGHT, 20)  # only the black square of the tag is so large and so grey
    down, right = np.nonzero(square)
    middle = np.array([(right.min() + right.max()) / 2 - columns.min(), rows.max() - (down.min() + down.max()) / 2])
    np.testing.assert_allclose(middle / PIXELS * scale, [across, up], atol=0.3 * scale)
    assert (np.ptp(right) + 19) / PIXELS * scale == pytest.approx(200.0, abs=0.3 * scale)
    (surface,) = [surface for surface in ROOM.surfaces() if surface.name == name]
    size = np.ptp(columns), np.ptp(rows)
    np.testing.assert_allclose(np.divide(size, PIXELS) * scale, 1000 * np.array(surface.extent), atol=0.5 * scale)


def test_a_view_is_that_of_a_tag_on_the_surface():
    for surface in ROOM.surfaces():
        view, (right, up) = View(surface), upright(surface.normal)
        middle = surface.point(*np.divide(surface.extent, 2.0))
        start = view.place(middle)
        np.testing.assert_allclose(view.place(middle + 0.1 * right) - start, [0.1, 0.0], atol=1e-12)
        np.testing.assert_allclose(view.place(middle + 0.1 * up) - start, [0.0, 0.1], atol=1e-12)
        np.testing.assert_allclose(view.place(view.corner(right=False, top=False)), [0.0, 0.0], atol=1e-12)
        np.testing.assert_allclose(view.place(view.corner(right=True, top=True)), surface.extent, atol=1e-12)


def test_keep_outs_are_measured_as_the_plan_shows_them():
    names = [surface.name for surface in floor_plans.lab(obstacles=[FACES]).surfaces()]
    assert {"ceiling", "hole_0_wall_3", "obstacle_0_x_min", "obstacle_0_y_max", "obstacle_0_bottom"} < set(names)
    for name in names:
        part = {"surface": name, "from_left": [0.1, 0.2], "from_below": [0.3, 0.4]}
        room = floor_plans.lab(obstacles=[FACES], keep_out=[part], band=None)
        (surface,) = [surface for surface in room.surfaces() if surface.name == name]
        seen = View(surface).place(np.array(room.plan.kept_out[0]))
        np.testing.assert_allclose([seen.min(axis=0), seen.max(axis=0)], [[0.1, 0.3], [0.2, 0.4]], atol=1e-9)
        corner = View(surface).corner(right=False, top=False) + 0.05 * upright(surface.normal)[0]
        assert View(surface).place(corner)[0] == pytest.approx(0.05)


def test_where_nothing_may_hang_is_grey(tmp_path):
    room = floor_plans.lab()
    (wall,) = [surface for surface in room.surfaces() if surface.name == "wall_0"]
    tag = Deployment(wall.point(3.0, 1.5)[None], wall.normal[None]).hung(room)
    write_plan(tmp_path / "plan.pdf", TagMap(room, TAG, tag), "a4")
    (page,) = pypdfium2.PdfDocument(tmp_path / "plan.pdf")
    assert "nothing hangs where it is grey" in words(page)
    picture = np.array(page.render(scale=PIXELS / 72 * 25.4, grayscale=True).to_pil())
    rows, columns = sides(picture)
    size = np.array([np.ptp(columns), np.ptp(rows)]) / [6.0, 2.5]  # pixels a metre

    def grey(x, z):
        """By hand: whoever stands before this wall has x to the left."""
        across, up = np.round(size * [6.0 - x, z]).astype(int)
        return bool(picture[rows.max() - up, columns.min() + across] < 250)

    # The door is from x = 4.5 to 5.5 m up to 2 m, and people reach from 0.25 to 2.25 m.
    assert all(grey(*at) for at in ((4.6, 0.3), (5.4, 1.9), (5.4, 2.4), (1.0, 0.2)))
    assert not any(grey(*at) for at in ((4.4, 0.3), (5.6, 1.9), (5.4, 2.1), (1.0, 0.3)))


def test_no_tag_hides_the_number_of_its_neighbour(tmp_path):
    (wall,) = [surface for surface in ROOM.surfaces() if surface.name == "x_min"]
    at, ids = wall.point(np.array([1.0, 1.13]), np.array([1.0, 1.0])), np.array([77, 88])
    tags = Deployment(at, np.repeat(wall.normal[None], 2, axis=0), labels=Labels(ids)).hung(ROOM)
    (page,) = written(tmp_path / "plan.pdf", tags, tag=Tag(0.1))
    text = page.get_textpage()

    def left_of(number):
        """Of the number in the drawing: in the table it is further to the right."""
        found, lefts = text.search(number), []
        while (match := found.get_next()) is not None:
            lefts.append(text.get_charbox(match[0])[0])
        assert len(lefts) == 2
        return min(lefts) / 72 * 25.4

    # At a scale of 1 : 25 the tags are 125 mm / 25 wide and 130 mm / 25 apart; the numbers are on either side of both.
    assert left_of("88") - left_of("77") > 130 / 25 + 125 / 25


def test_every_tag_is_in_one_table_even_where_they_go_on_another_page(tmp_path):
    deployment = UniformDeployment(300).draw(ROOM, np.random.default_rng(0))
    pages = written(tmp_path / "plan.pdf", deployment, tag=Tag(0.05))
    assert len(pages) == 12  # 50 on each of six surfaces
    text = [words(page) for page in pages]
    for index, surface in enumerate(ROOM.surfaces()):
        view = View(surface)
        own = " ".join(page for page in text if page.startswith(f"{surface.name},"))
        for number in np.flatnonzero(deployment.surfaces == index):
            across, up = 1000 * view.place(deployment.positions[number])
            assert f" {number} {across:.0f} {up:.0f} " in own


def test_tags_near_a_surface_belong_to_it_and_others_are_listed_apart(tmp_path):
    positions, normals = np.array([[0.03, 1.0, 1.2], [3.0, 2.0, 1.0]]), np.array([[1.0, 0.0, 0.0]] * 2)
    near, free = written(tmp_path / "plan.pdf", Deployment(positions, normals).hung(ROOM))
    assert words(near).startswith("x_min, seen from the front")
    assert "0 1000 1200 875 1075" in words(near)
    assert words(free).startswith("free in the room on no surface, tags: 1;")
    assert "1 3000 2000 1000" in words(free)
