"""Drives in which most images show one tag: groups that motion joins, and their covariances."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from support import drives, thorough, walks

from lmd.core.checks import InputError
from lmd.geometry.se3 import act, adjoint_matrix, inverse, log, pose_of, rigid_alignment
from lmd.scene.tag import Tag
from lmd.survey.knowledge import PriorKnowledge
from lmd.survey.results import tag_columns, to_text
from lmd.survey.survey import survey

LENGTH, COUNT = 12.0, 9
SLACK = 1.15  # factor of chi^2, as each drive estimates its spread from some hundred links
SEEDS = range(1 if thorough.SHARE < 1.0 else round(8 * thorough.SHARE))
more_drives = pytest.mark.thorough("lmd/survey", "lmd/adjust", "tests/support/drives.py")


def found_of(driven, known, detected=None):
    detected = driven.detected if detected is None else detected
    return survey(detected, [drives.CAMERA], Tag(drives.EDGE), walks.constant_errors(0.2), known)


def off(found, true):
    """Distances of the tags of the map from their true places, metres, once the maps are laid over each other."""
    return walks.apart(found.found.poses.tags[found.placed], true[found.ids[found.placed]])


def square_of(found, true):
    """chi^2 of the poses of all tags of the map beside the first one, and its degrees of freedom."""
    ids, some = found.ids, np.flatnonzero(found.placed)
    every = found.found
    whole = every.covariance
    first, rest = some[0], some[1:]
    slopes = np.zeros((6 * len(rest), 6 * len(ids)))
    off = np.empty((len(rest), 6))
    for n, k in enumerate(rest):
        here = inverse(every.poses.tags[first]) @ every.poses.tags[k]
        off[n] = log(inverse(here) @ inverse(true[ids[first]]) @ true[ids[k]])
        slopes[6 * n : 6 * n + 6, 6 * k : 6 * k + 6] = np.eye(6)
        slopes[6 * n : 6 * n + 6, 6 * first : 6 * first + 6] = -adjoint_matrix(inverse(here))
    rows = np.flatnonzero(slopes.any(axis=0))
    covariance = slopes[:, rows] @ whole[np.ix_(rows, rows)] @ slopes[:, rows].T
    return float(off.ravel() @ np.linalg.solve(covariance, off.ravel())), off.size


@pytest.mark.parametrize("by", ["leaning odometry", "constant velocity", pytest.param("odometry", marks=more_drives)])
def test_covariances_across_joined_groups_hold(by):
    squares = []
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        driven = drives.drive(LENGTH, COUNT, rng, dark=0.0 if by == "constant velocity" else 0.1)
        known = PriorKnowledge()
        if by != "constant velocity":
            lean = (0.01, 0.003) if by.startswith("leaning") else (0.0, 0.0)
            known = PriorKnowledge(odometry=drives.odometry(driven, rng, lean=lean))
        found = found_of(driven, known)
        assert found.joined.max() >= 0
        assert found.placed.sum() >= (3 if by == "constant velocity" else COUNT - 3)
        squares.append(square_of(found, driven.tags))
    total, freedom = np.sum(squares, axis=0)
    low, high = chi2.ppf([0.005, 0.995], freedom)
    assert low < total < SLACK * high, f"{total:.0f} of {freedom}"


def test_odometry_joins_groups_that_no_image_connects():
    rng = np.random.default_rng(5)
    driven = drives.drive(LENGTH, COUNT, rng, alone=1.0, dark=0.1)
    with pytest.raises(InputError, match="detections"):
        found_of(driven, PriorKnowledge(steady=False))
    found = found_of(driven, PriorKnowledge(odometry=drives.odometry(driven, rng)))
    said = to_text(found)
    assert f"it joins {found.placed.sum()} groups of tags" in said
    assert "odometry drifts" in said
    assert (off(found, driven.tags) < 4.0 * found.found.sigmas[found.placed]).all()


@more_drives
@pytest.mark.parametrize("seed", [1, 7])
def test_an_id_that_was_misread_twice_does_not_place_a_tag_elsewhere(seed):
    """Images alone have tag 7 near tag 1, some 8 m off; motion places it rightly, or not at all."""
    rng = np.random.default_rng(seed)
    driven = drives.drive(LENGTH, COUNT, rng, alone=0.5, dark=0.1)
    detected = driven.detected
    alone = np.bincount(detected.frame)[detected.frame] == 1
    detected = detected.of(np.flatnonzero((detected.ids != 7) | alone))
    alone = np.bincount(detected.frame, minlength=len(detected.times))[detected.frame] == 1
    ids = detected.ids.copy()
    ids[np.flatnonzero((ids == 1) & ~alone)[:2]] = 7
    detected = replace(detected, ids=ids)

    def errors(known):
        found = found_of(driven, known, detected)
        if known.odometry is not None:
            assert found.faults.misread[found.ids == 7] == 2
        some = np.flatnonzero(found.placed)
        here, there = found.found.poses.tags[some, :3, 3], driven.tags[found.ids[some], :3, 3]
        right = found.ids[some] != 7
        away = np.linalg.norm(act(rigid_alignment(here[right], there[right]), here) - there, axis=1)
        return away[right].max(), away[~right]

    assert errors(PriorKnowledge(steady=False))[1] > 5.0
    rest, own = errors(PriorKnowledge())
    assert rest < 0.3
    assert (own < 0.3).all()
    rest, own = errors(PriorKnowledge(odometry=drives.odometry(driven, rng)))
    assert rest < 0.1
    assert own < 0.1


def test_frames_of_several_tags_do_not_depend_on_motion():
    rng = np.random.default_rng(3)
    tags = walks.spaced_tags(12, rng)
    detected = walks.photographed(tags, walks.walk(12, rng), rng)
    close = replace(detected, times=tuple(f"{0.1 * k:.1f}" for k in range(len(detected.times))))
    cameras, tag, errors = [walks.CAMERA], Tag(walks.EDGE), walks.constant_errors(0.2)
    one, other = (survey(some, cameras, tag, errors, PriorKnowledge()) for some in (detected, close))
    assert one.joined.max() == other.joined.max() == -1
    assert (one.found.poses.tags == other.found.poses.tags).all()
    assert np.array_equal(one.found.covariances, other.found.covariances, equal_nan=True)


def test_a_tag_that_is_hardly_known_is_not_placed(monkeypatch):
    rng = np.random.default_rng(6)
    driven = drives.drive(8.0, 6, rng, dark=0.1)
    known = PriorKnowledge(odometry=drives.odometry(driven, rng))
    sigmas = found_of(driven, known).found.sigmas
    monkeypatch.setattr("lmd.survey.survey.LOOSE_SHARE", 0.0)
    monkeypatch.setattr("lmd.survey.survey.LOOSE_M", float(np.nanmedian(sigmas)))
    found = found_of(driven, known)
    assert (found.found.sigmas[found.placed] <= np.nanmedian(sigmas)).all()
    assert (found.found.sigmas[found.loose] > np.nanmedian(sigmas)).all()
    assert set(np.asarray(tag_columns(found)["state"])[found.loose]) == {"hardly known"}
    assert f"{found.placed.sum()} of {(found.placed | found.loose).sum()} placed" in to_text(found)
    monkeypatch.setattr("lmd.survey.survey.LOOSE_M", 1e-6)
    with pytest.raises(InputError, match="or no tag's pose relative to the others is accurate"):
        found_of(driven, known)


def test_odometry_of_a_body_whose_camera_looks_elsewhere_is_refused():
    rng = np.random.default_rng(5)
    driven = drives.drive(8.0, 6, rng, dark=0.1)
    odometry = drives.odometry(driven, rng)
    body = pose_of(np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]), np.array([0.1, 0.2, -0.5]))
    with pytest.raises(InputError, match="odometry contradicts the motion in the images"):
        found_of(driven, PriorKnowledge(odometry=replace(odometry, poses=odometry.poses @ body)))
