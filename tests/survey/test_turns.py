"""Tags whose corners begin elsewhere, or that hang turned: images by cv2.projectPoints of plain squares."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from support import walks

from lmd.formats.detections import DetectedTags
from lmd.scene.deployment import Deployment
from lmd.scene.labels import Labels, Surveyed
from lmd.survey.knowledge import Boards
from lmd.survey.results import map_of, to_text

IDS = np.array([2, 3, 5, 7, 11])
PLACES = np.array([[0.5, 0.0, 1.0], [1.0, 0.0, 1.4], [1.6, 0.0, 0.9], [2.0, 0.0, 1.5], [0.0, 0.7, 1.2]])
NORMALS = np.array([[0.0, 1.0, 0.0]] * 4 + [[1.0, 0.0, 0.0]])
EYES = [(1.0, 2.0, 1.2), (1.6, 1.8, 1.6), (0.9, 2.4, 0.8), (1.3, 1.6, 1.1), (2.0, 2.2, 1.3), (0.8, 2.0, 1.7)]
EDGE, SIGMA = 0.15, 0.1
WORDS = {1: "a quarter turn clockwise", 2: "half a turn", 3: "a quarter turn counter-clockwise"}


def plan(places=PLACES):
    return Deployment(places, NORMALS, labels=Labels(IDS))


def seen(clockwise, places=PLACES, rolled=0):
    """Detections in six photographs of tags turned clockwise by quarters, with corners that begin at `rolled`."""
    camera, rng = walks.CAMERA, np.random.default_rng(3)
    matrix = np.eye(3)
    (matrix[0, 0], matrix[1, 1]), matrix[:2, 2] = camera.focal_pixels, camera.principal_point
    rows = []
    for frame, eye in enumerate(EYES):
        ahead = np.array([1.0, 0.1, 1.2]) - eye
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        turn = np.stack([right, np.cross(ahead, right), ahead])
        for k, normal in enumerate(NORMALS):
            tag_right = np.cross([0.0, 0.0, 1.0], normal)
            angle = -clockwise[k] * np.pi / 2.0
            x = np.cos(angle) * tag_right + np.sin(angle) * np.array([0.0, 0.0, 1.0])
            y = np.cross(normal, x)
            square = [places[k] + EDGE / 2.0 * (a * x + b * y) for a, b in ((-1, 1), (1, 1), (1, -1), (-1, -1))]
            image = cv2.projectPoints(np.array(square), turn, -turn @ np.array(eye), matrix, None)[0].reshape(4, 2)
            corners = [image[(corner + rolled) % 4] for corner in range(4)]
            rows.append((frame, IDS[k], corners + rng.normal(0.0, SIGMA, (4, 2))))
    frames, ids, corners = (np.array(column) for column in zip(*rows, strict=True))
    return DetectedTags(tuple("abcdef"), ("",), frames, 0 * frames, ids, corners)


def surveyed(detected, **known):
    return walks.surveyed(detected, SIGMA, edge=EDGE, **known)


def line(found, label):
    """Text after a label in the terminal; None without that line."""
    rows = dict(row.split(maxsplit=1) for row in to_text(found).splitlines())
    return rows.get(label)


@pytest.mark.parametrize(("rolled", "as_fixed"), [(1, True), (2, False), (3, True)])
def test_corners_that_begin_elsewhere_are_renumbered_and_the_tags_named(rolled, as_fixed):
    found = surveyed(seen([0] * 5, rolled=rolled), **{"fixed" if as_fixed else "plan": plan()})
    tags = map_of(found)
    assert tags.ids.tolist() == IDS.tolist()
    np.testing.assert_allclose(tags.places, PLACES, atol=1e-6 if as_fixed else 2e-3)
    np.testing.assert_allclose(tags.ups, np.tile([0.0, 0.0, 1.0], (5, 1)), atol=0.01)
    assert line(found, "turned") == f"{WORDS[rolled]}: 2, 3, 5, 7, 11; their corners are renumbered"


def test_tags_as_planned_have_no_such_line():
    for known in ({"plan": plan()}, {"fixed": plan()}):
        found = surveyed(seen([0] * 5), **known)
        assert line(found, "turned") is None
        assert line(found, "fixed") is None


@pytest.mark.parametrize("clockwise", [(2, 0, 0, 2, 0), (1, 3, 0, 0, 0), (0, 0, 0, 0, 1)])
def test_planned_tags_that_hang_turned_hang_so_in_the_map(clockwise):
    found = surveyed(seen(clockwise), plan=plan())
    tags = map_of(found)
    np.testing.assert_allclose(tags.places, PLACES, atol=2e-3)
    for k, quarters in enumerate(clockwise):
        right = np.cross([0.0, 0.0, 1.0], NORMALS[k])
        up = [np.array([0.0, 0.0, 1.0]), right, np.array([0.0, 0.0, -1.0]), -right][quarters]
        np.testing.assert_allclose(tags.ups[k], up, atol=0.01)
        if quarters:
            assert f"{WORDS[quarters]}: " in line(found, "turned")
    assert "the map has them as they hang" in line(found, "turned")


@pytest.mark.parametrize("clockwise", [(2, 0, 0, 2, 1), (0, 0, 0, 0, 3), (2, 2, 2, 2, 0)])
def test_fixed_tags_keep_their_poses_at_any_turn(clockwise):
    found = surveyed(seen(clockwise), fixed=plan())
    np.testing.assert_allclose(map_of(found).places, PLACES, atol=1e-6)
    np.testing.assert_allclose(map_of(found).ups, np.tile([0.0, 0.0, 1.0], (5, 1)), atol=1e-6)
    assert "their corners are renumbered" in line(found, "turned")
    named = "".join(line(found, "turned"))
    assert all(str(IDS[k]) in named for k in np.flatnonzero(clockwise))


def test_two_fixed_tags_are_enough():
    few = slice(0, 2)
    found = surveyed(seen([0] * 5, rolled=2), fixed=plan()[few])
    np.testing.assert_allclose(map_of(found).places, PLACES, atol=0.01)
    np.testing.assert_allclose(map_of(found).places[few], PLACES[few], atol=1e-6)


def test_corners_of_lmds_own_detectors_are_not_renumbered():
    """So all tags really hang upside down."""
    detected = seen([2] * 5)
    own = DetectedTags.together({"": detected})
    assert not own.in_order
    found = surveyed(replace(own, in_order=True), plan=plan())
    np.testing.assert_allclose(map_of(found).places, PLACES, atol=2e-3)
    np.testing.assert_allclose(map_of(found).ups, np.tile([0.0, 0.0, -1.0], (5, 1)), atol=0.01)
    assert "the map has them as they hang" in line(found, "turned")


def test_without_a_plan_the_world_is_that_of_the_tag_as_it_was_seen():
    found = surveyed(seen([0] * 5, rolled=2), origin=2)
    tags = map_of(found)
    away = np.linalg.norm(tags.places[:, None] - tags.places, axis=-1)
    np.testing.assert_allclose(away, np.linalg.norm(PLACES[:, None] - PLACES, axis=-1), atol=5e-3)
    np.testing.assert_allclose(tags.ups[:4], np.tile([0.0, 1.0, 0.0], (4, 1)), atol=0.01)


@pytest.mark.parametrize("rolled", [0, 1])
def test_tags_of_one_sheet_say_which_corner_is_the_first(rolled):
    """On this wall the viewer's right is along -x."""
    places = np.stack([-PLACES[:4, 0], PLACES[:4, 2]], axis=1)
    boards = Boards(("sheet",) * 4, IDS[:4], places, 0.0002)
    found = surveyed(seen([0] * 5, rolled=rolled), boards=boards, origin=2)
    tags = map_of(found)
    np.testing.assert_allclose(tags.places[:4, :2], places - places[0], atol=3e-3)
    np.testing.assert_allclose(tags.ups[:4], np.tile([0.0, 1.0, 0.0], (4, 1)), atol=0.01)
    assert (line(found, "turned") is not None) == bool(rolled)


def test_a_fixed_tag_that_hangs_elsewhere_is_named():
    hangs = PLACES.copy()
    hangs[2] += [0.0, 0.0, 0.3]
    found = surveyed(seen([0] * 5, hangs), fixed=plan())
    np.testing.assert_allclose(map_of(found).places, PLACES[np.isin(IDS, map_of(found).ids)], atol=1e-6)
    assert line(found, "fixed") == "5 hangs elsewhere in the photographs"


@pytest.mark.parametrize(
    ("seed", "turned", "as_fixed"),
    [(0, "all", False), (0, "each", True), (2, "all", True), (2, "each", False)],
)
def test_a_room_of_turned_tags_is_mapped_like_an_upright_one(seed, turned, as_fixed):
    """With a tenth of wrong ids for one of the seeds."""
    rng, count = np.random.default_rng(seed), 20
    planned = walks.spaced_tags(count, rng)
    true = walks.hung(planned, rng)
    detected = walks.photographed(true, walks.walk(40, rng), rng, 0.2)
    quarters = np.full(count, 2) if turned == "all" else rng.integers(0, 4, count)
    rolled = np.stack([np.roll(c, -quarters[k], axis=0) for c, k in zip(detected.corners, detected.ids, strict=True)])
    if seed == 2:
        wrong = rng.random(len(detected)) < 0.1
        detected = replace(detected, ids=np.where(wrong, (detected.ids + 7) % count, detected.ids))
    known = true if as_fixed else planned
    deployment = Deployment(
        known[:, :3, 3], known[:, :3, 2],
        surveyed=Surveyed(known[:, :3, 3], known[:, :3, 3], known[:, :3, 1]),
    )  # fmt: skip
    found = walks.surveyed(replace(detected, corners=rolled), **{"fixed" if as_fixed else "plan": deployment})
    tags = map_of(found)
    assert len(tags) >= count - 1
    off = np.linalg.norm(tags.places - true[tags.ids, :3, 3], axis=1)
    assert off.max() < (1e-5 if as_fixed else 0.02)
    if as_fixed or turned == "all":
        assert (tags.ups * true[tags.ids, :3, 1]).sum(axis=1).min() > 0.99
        np.testing.assert_array_equal(found.turns[0][tags.ids], quarters[tags.ids])
    else:
        np.testing.assert_array_equal(found.turns[1][tags.ids], quarters[tags.ids])
