"""A whole survey and its results."""

from dataclasses import replace

import numpy as np
import pytest
from support import walks

from lmd.core.checks import InputError
from lmd.detection.corner_errors import inward
from lmd.geometry.se3 import exp, inverse
from lmd.plot import plans
from lmd.scene.deployment import Deployment
from lmd.scene.labels import Labels, Surveyed
from lmd.scene.tag import Tag
from lmd.survey.knowledge import MeasuredPoints, PriorKnowledge, poses_of
from lmd.survey.results import map_columns, map_of, measured_of, metrics, survey_document, to_text

COUNT, FRAMES, SIGMA = 24, 60, 0.2
UNSEEN, UNPLANNED, ODD = 7, 23, 11


def plan_of(poses, ids, edges=None):
    places = poses[:, :3, 3]
    surveyed = Surveyed(places, places, poses[:, :3, 1])
    return Deployment(places, poses[:, :3, 2], labels=Labels(ids), surveyed=surveyed, edges=edges)


@pytest.fixture(scope="module")
def room():
    """True poses of tags, the plan of all but one, and detections of all but another one."""
    rng = np.random.default_rng(31)
    plan = walks.spaced_tags(COUNT, rng)
    true, edges = walks.hung(plan, rng), np.full(COUNT, walks.EDGE)
    edges[ODD] *= 1.5
    detected = walks.photographed(true, walks.walk(FRAMES, rng), rng, SIGMA, edges=edges)
    detected = detected.of(np.flatnonzero(detected.ids != UNSEEN))
    planned = np.flatnonzero(np.arange(COUNT) != UNPLANNED)
    sizes = np.where(planned == ODD, 0.15, np.nan)
    return true, plan_of(plan[planned], planned, sizes), detected


@pytest.fixture(scope="module")
def found(room):
    _, plan, detected = room
    return walks.surveyed(detected, plan=plan)


def test_the_map_has_the_tags_seen_and_the_measured_file_those_planned(room, found):
    true, plan, _ = room
    tags, measured = map_of(found), measured_of(found)
    assert tags.ids.tolist() == [k for k in range(COUNT) if k != UNSEEN]
    assert tags.edges[[ODD - 1]] == pytest.approx(0.15)  # by the plan
    assert found.faults.sizes == {}
    assert measured.ids.tolist() == plan.ids.tolist()
    index = plan.ids.tolist().index(UNSEEN)
    np.testing.assert_array_equal(measured.places[index], plan.places[index])
    off = np.linalg.norm(np.delete(measured.places - true[plan.ids, :3, 3], index, axis=0), axis=1)
    assert np.median(off) < 0.006  # the plan alone gives the world
    np.testing.assert_allclose(poses_of(tags), found.found.poses.tags[found.placed], atol=1e-12)


def test_tags_that_need_attention_are_named(found):
    text, document = to_text(found), survey_document(found)
    assert f"\nnot seen    {UNSEEN}\n" in f"{text}\n"
    assert f"\nnot planned {UNPLANNED}\n" in f"{text}\n"
    assert {row["id"]: row["state"] for row in document["tags"]}[UNPLANNED] == "placed"


def test_a_tag_far_from_its_plan_is_named_and_capped_in_the_picture(room, tmp_path, monkeypatch):
    _, plan, detected = room
    off = plan_of(
        poses_of(plan) @ exp(np.where(plan.ids[:, None] == 3, [0, 0, 0, 0.155, 0, 0], 0.0)), plan.ids, plan.edges
    )
    found = walks.surveyed(detected, plan=off)
    assert "mm off their plan; farthest: 3 (1" in to_text(found)
    axes = {}
    monkeypatch.setattr(plans, "shrink", lambda _path: axes.update(enumerate(figures[-1].axes)))
    figures = []
    made = plans.new_panels
    monkeypatch.setattr(plans, "new_panels", lambda *size: (figures.append((both := made(*size))[0]), both)[1])
    plans.save_survey_figure(tmp_path / "survey.png", found, None, "")
    assert np.ptp(axes[1].get_xlim()) < 100.0  # millimetres
    assert any(text.get_text().startswith("  3 (1") for text in axes[1].texts)


def test_frames_that_are_held_out_fit_the_map(found):
    assert metrics(found)["held_out_error/50"] < 1.5 * SIGMA * np.sqrt(2.0)
    assert len(found.held_out.shifts) >= FRAMES // 8


def test_covariances_of_the_map_are_in_the_world_frame(found):
    columns = map_columns(found)
    k = int(np.flatnonzero(found.placed)[0])
    turned = found.found.poses.tags[k, :3, :3]
    expected = turned @ found.found.covariances[k, 3:, 3:] @ turned.T
    written = [[columns[f"cov_{min(a, b)}_{max(a, b)}"][0] for b in "xyz"] for a in "xyz"]
    np.testing.assert_allclose(written, expected, rtol=1e-9)


def test_a_fixed_tag_defines_the_world(room):
    true, _, detected = room
    pose, other = walks.surveyed(detected, fixed=plan_of(true[:1], np.array([0]))).found.poses.tags[[0, 4]]
    np.testing.assert_allclose(pose, true[0], atol=1e-4)
    relative = inverse(true[0]) @ true[4]
    np.testing.assert_allclose((inverse(pose) @ other)[:3, 3], relative[:3, 3], atol=0.01)


def test_three_centres_by_a_tape_measure_define_the_world(room):
    true, _, detected = room
    few = np.array([0, 5, 10])
    points = MeasuredPoints(few, true[few, :3, 3] + np.random.default_rng(0).normal(0.0, 0.002, (3, 3)))
    found = walks.surveyed(detected, points=points)
    off = np.linalg.norm(found.found.poses.tags[found.placed, :3, 3] - true[found.ids[found.placed], :3, 3], axis=1)
    assert np.median(off) < 0.006
    assert off.max() < 0.015
    unseen = np.array([0, 5, UNSEEN])
    with pytest.raises(InputError, match=r"^points needs three tags"):
        walks.surveyed(detected, points=MeasuredPoints(unseen, true[unseen, :3, 3]))


@pytest.mark.parametrize(
    ("ids", "places", "message"),
    [
        ([1, 2], np.eye(3)[:2], r"^points must have at least 3 tags, got 2\.$"),
        ([1, 2, 1], np.eye(3), r"^points has a tag twice\.$"),
        ([1, 2, 3], np.outer([0, 1, 2], [1, 1, 1]), r"^points must not be collinear\.$"),
    ],
)
def test_points_that_fix_no_world_are_refused(ids, places, message):
    with pytest.raises(InputError, match=message):
        MeasuredPoints(np.array(ids), np.asarray(places, dtype=np.float64))


def test_ids_that_were_read_once_are_not_in_the_map(room):
    _, plan, detected = room
    ids = detected.ids.copy()
    ids[5], ids[9] = 100, 101
    found = walks.surveyed(replace(detected, ids=ids), plan=plan)
    assert set(map_of(found).ids.tolist()) == {k for k in range(COUNT) if k != UNSEEN}
    assert set(found.ids.tolist()) == set(range(COUNT))


@pytest.mark.parametrize("planned", [False, True])
def test_corners_that_do_not_go_around_a_tag_are_refused(room, planned):
    _, plan, detected = room
    few = detected.of(np.flatnonzero(detected.frame < 10))
    crossed = replace(few, corners=few.corners[:, [0, 2, 1, 3]])
    with pytest.raises(InputError, match=r"^detections: (the corners of tag \d+ are|no two tags of a frame agree)"):
        walks.surveyed(crossed, plan=plan if planned else None)


def test_frames_that_contradict_each_other_are_refused(room):
    *_, detected = room
    few, rng = detected.of(np.flatnonzero(detected.frame < 4)), np.random.default_rng(3)
    corners = few.corners.copy()
    for frame in range(4):
        (own,) = np.nonzero(few.frame == frame)
        corners[own] = corners[rng.permutation(own)]
    with pytest.raises(InputError, match=r"^detections: no tag is placed, as no 2 sightings of a tag agree"):
        walks.surveyed(replace(few, corners=corners))


def test_detections_of_other_tags_are_refused(room):
    _, plan, detected = room
    with pytest.raises(InputError, match=r"^detections must show a tag of the plan, or another tag at least twice\.$"):
        walks.surveyed(replace(detected, ids=300 + np.arange(len(detected)) % 200).of(np.arange(100)), plan=plan[:1])


@pytest.mark.parametrize(("said", "shift", "doubted"), [(0.0975, 0.0, True), (0.1, 0.0, False), (0.1, -0.4, False)])
def test_another_edge_is_told_from_a_shift_of_corners_where_places_are_known(said, shift, doubted):
    """Tags are 0.1 m; with 0.0975 m the photographs look as if their corners lay outward."""
    rng = np.random.default_rng(5)
    true = walks.spaced_tags(12, rng)
    detected = walks.photographed(true, walks.walk(40, rng), rng, SIGMA)
    detected = replace(detected, corners=detected.corners + shift * inward(detected.corners))
    errors = replace(walks.constant_errors(SIGMA), inward_spread=0.3)
    found = walks.surveyed(detected, edge=said, errors=errors, fixed=plan_of(true, np.arange(12)))
    assert len(found.doubts) == doubted
    assert not doubted or found.doubts[0].startswith("tags that are 2 % larger than 97.5 mm explain")
    assert abs(found.found.calibrated[0].shift - shift) < 0.05 or doubted


def test_sizes_by_id_are_those_of_the_tags():
    known = PriorKnowledge(sizes={3: 0.125})
    assert known.edges(np.array([2, 3]), Tag(0.2)).tolist() == [0.2, 0.125]
    for sizes, said in (([1], "edges must give metres by id"), ({3: -1.0}, "edges of tag 3 must be")):
        with pytest.raises(InputError, match=said):
            PriorKnowledge(sizes=sizes)
