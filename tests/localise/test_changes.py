"""Changes of a map: tags that were moved, and that are new."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from support import localisations as ld
from support import walks

from lmd.geometry.se3 import exp
from lmd.localise.changes import MOVED_CHI_SQUARE, displacements
from lmd.localise.fixed_map import FixedMap
from lmd.localise.results import change_columns, localise_document, to_text


def kinds(result):
    return {(change.tag, change.kind) for change in result.changes}


def moved_by(metres, seed):
    """Twist by a shift in a random direction."""
    way = np.random.default_rng(seed).normal(size=3)
    return np.r_[np.zeros(3), metres * way / np.linalg.norm(way)]


def test_the_statistic_has_its_distribution_and_no_tag_is_a_false_alarm():
    """6 walks with 16 tags each, of which none was moved; errors of corners and of the map are as stated."""
    squares = []
    for seed in range(6):
        walk = ld.walked(seed)
        result = ld.localised(walk)
        assert result.changes == ()
        values, covariances = displacements(*ld.compared(walk))
        there = np.isfinite(values[:, 0])
        squares += np.einsum("ki,kij,kj->k", values, np.linalg.inv(covariances), values)[there].tolist()
    assert len(squares) > 80
    low, high = chi2.ppf([0.005, 0.995], 6 * len(squares))
    assert low < np.sum(squares) < high
    assert max(squares) < MOVED_CHI_SQUARE


@pytest.mark.parametrize("metres", [0.02, 0.1, 0.6])
def test_a_moved_tag_is_found_and_its_images_are_localised_with_its_new_pose(metres):
    for seed in range(2):
        tag = 5 + seed
        walk = ld.walked(seed, moved={tag: moved_by(metres, seed)})
        result = ld.localised(walk)
        assert kinds(result) == {(tag, "moved")}
        (one,) = result.changes
        assert abs(np.linalg.norm(one.shift) - metres) < 0.008
        off = np.linalg.norm(one.pose[:3, 3] - walk.true[tag, :3, 3])
        assert off < 4.0 * np.sqrt(np.trace(one.covariance[3:, 3:]))
        square = ld.squares(result.found.poses.frames, result.found.frame_covariances, walk.frames)[:, 0]
        assert square.mean() < 12.0
        assert f"tag {tag} was moved by {1e3 * np.linalg.norm(one.shift):.3g} mm" in to_text(result)


def test_two_moved_tags_and_one_that_turned_are_all_found():
    moved = {2: moved_by(0.03, 0), 9: moved_by(0.5, 1), 12: np.r_[0.0, 0.0, 0.3, 0.0, 0.0, 0.0]}
    result = ld.localised(ld.walked(4, moved=moved))
    assert kinds(result) == {(2, "moved"), (9, "moved"), (12, "moved")}
    table = change_columns(result)
    assert table["rotation"][2] == pytest.approx(0.3, abs=0.03)
    assert table["distance"][2] < 0.01
    shift = [table[f"moved_{name}"][0] for name in ("right", "up", "out")]
    np.testing.assert_allclose(shift, moved[2][3:], atol=0.006)


def test_a_tag_that_no_image_shows_is_named():
    walk = ld.walked(6)
    result = ld.localised(walk, walk.detected.of(np.flatnonzero(walk.detected.ids != 13)))
    assert kinds(result) == set()
    assert "not seen 13" in to_text(result)


@pytest.mark.parametrize("number", [3, 40])
def test_a_tag_that_the_map_lacks_is_new(number):
    """Tag 7 is not in the map; its id comes between the ids of the map, or after them."""
    walk = ld.walked(8)
    ids = np.array([0, 1, 2, *range(4, 8), number, *range(8, 16)]) if number == 3 else np.arange(16)
    new = 7
    kept = np.flatnonzero(np.arange(16) != new)
    renamed = np.where(walk.detected.ids == new, 40, walk.detected.ids + (walk.detected.ids >= number))
    if number == 40:
        renamed = np.where(walk.detected.ids == new, 40, walk.detected.ids)
        known = FixedMap(ids[kept], walk.known.poses[kept], walk.known.edges[kept], walk.known.sigmas[kept])
        numbered = 40
    else:
        own = np.arange(16) + (np.arange(16) >= 3)
        renamed = np.where(walk.detected.ids == new, 3, own[walk.detected.ids])
        known = FixedMap(own[kept], walk.known.poses[kept], walk.known.edges[kept], walk.known.sigmas[kept])
        numbered = 3
    result = ld.localised(walk._replace(known=known), replace(walk.detected, ids=renamed))
    assert kinds(result) == {(numbered, "new")}
    (one,) = result.changes
    off = np.linalg.norm(one.pose[:3, 3] - walk.true[new, :3, 3])
    assert off < 4.0 * np.sqrt(np.trace(one.covariance[3:, 3:]))
    assert localise_document(result)["changes"][0].startswith(f"tag {numbered} is new, at (")


def test_ids_that_were_misread_change_nothing():
    """Three per cent of the ids are those of other tags."""
    walk = ld.walked(9, frames=100)
    rng = np.random.default_rng(0)
    wrong = rng.uniform(size=len(walk.detected)) < 0.03
    ids = np.where(wrong, rng.integers(0, 60, len(wrong)), walk.detected.ids)
    result = ld.localised(walk, replace(walk.detected, ids=ids))
    assert kinds(result) == set()


def test_a_tag_whose_sightings_contradict_each_other_was_not_moved():
    """Each sighting of tag 5 is up to 80 pixels off."""
    walk = ld.walked(2)
    corners = walk.detected.corners.copy()
    own = walk.detected.ids == 5
    corners[own] += np.random.default_rng(0).uniform(-80.0, 80.0, (own.sum(), 1, 2))
    assert kinds(ld.localised(walk, replace(walk.detected, corners=corners))) == set()


def test_a_second_tag_of_an_id_is_named_with_its_place():
    walk = ld.walked(4)
    twin = walk.true[5] @ exp(np.array([0.0, 0.0, 0.0, 0.3, 0.2, 0.0]))
    tags, ids = np.concatenate([walk.true, twin[None]]), np.append(walk.known.ids, 5)
    detected = walks.photographed(tags, walk.frames, np.random.default_rng(4), ld.NOISE, ids=ids)
    (said,) = ld.localised(walk, replace(detected, in_order=True)).doubts
    assert said.startswith(f"tag 5 hangs at ({', '.join(f'{x:.2f}' for x in twin[:3, 3])}) as well")


def test_a_map_that_the_images_contradict_as_a_whole_has_no_moved_tags():
    """The map states a fiftieth of its errors."""
    walk = ld.walked(3, place=0.01, turn=0.02)
    result = ld.localised(walk._replace(known=replace(walk.known, sigmas=walk.known.sigmas / 50.0)))
    assert result.changes == ()
    assert result.comparison.contradicted > 4
    assert f"{result.comparison.contradicted} tags differ from it, too many to have been moved" in to_text(result)
