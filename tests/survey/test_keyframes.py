"""Keyframes of videos and of drives."""

import numpy as np
import pytest
from support import drives

from lmd.adjust.motion import SHORTEST_GAP
from lmd.core.checks import IntArray
from lmd.formats.detections import DetectedTags
from lmd.survey.keyframes import LONGEST, select_keyframes


def video(shown, rate: float | None = 30.0, cameras=1) -> DetectedTags:
    """Detections in frames, each a list of `(camera, id)`."""
    rows = [(frame, *tag) for frame, tags in enumerate(shown) for tag in tags]
    frame, camera, ids = np.array(rows).T
    corners = np.tile(np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 20.0], [0.0, 20.0]]), (len(rows), 1, 1))
    times = [f"{k:04}.png" if rate is None else f"{1e9 + k / rate:.4f}" for k in range(len(shown))]
    return DetectedTags(tuple(times), tuple(map(str, range(cameras))), frame, camera, ids, corners)


def kept_of(detected: DetectedTags) -> IntArray:
    return np.unique(detected.frame)


PAIR = [(0, 1), (0, 2)]


def test_keyframes_of_a_fast_video_are_even_and_the_others_are_listed():
    before = video([PAIR] * 61)
    found = select_keyframes(before)
    kept = kept_of(found)
    assert np.diff(kept).tolist() == [6] * 10
    assert [before.times[k] for k in range(61) if k not in kept] == list(found.left_out)
    np.testing.assert_array_equal(found.images[:, 0], np.isin(np.arange(61), kept))


@pytest.mark.parametrize("rate", [5.0, 2.3, None])
def test_all_frames_of_slow_recordings_and_photographs_are_kept(rate):
    assert not select_keyframes(video([PAIR] * 40, rate)).left_out


@pytest.mark.parametrize("alone", [[(0, 1), (0, 3)], [(0, 1), (0, 2), (0, 4)]])
def test_a_frame_that_alone_shows_a_tag_or_two_together_is_kept(alone):
    shown = [PAIR] * 30 + [[(0, 2), (0, 3)]] * 31
    shown[21] = alone
    assert 21 in kept_of(select_keyframes(video(shown)))


def test_frames_are_kept_where_all_tags_change():
    shown = [[(0, 1)]] * 30 + [[(0, 2)]] * 30
    kept = kept_of(select_keyframes(video(shown)))
    near = np.flatnonzero(np.abs(np.arange(60) - 29.5) / 30.0 < SHORTEST_GAP)
    assert np.isin(near, kept).all()
    assert len(kept) < 30


def test_a_rig_keeps_all_cameras_of_a_moment():
    both = [(0, 1), (0, 2), (1, 2), (1, 3)]
    before = video([both] * 31, cameras=2)
    found = select_keyframes(before)
    for frame in kept_of(found):
        assert (found.frame == frame).sum() == 4
    np.testing.assert_array_equal(found.images[:, 0], found.images[:, 1])


def test_each_third_frame_with_tags_is_kept():
    shown = [[]] + [PAIR] * 7 + [[], PAIR]
    found = select_keyframes(video(shown, None), 3)
    assert kept_of(found).tolist() == [1, 4, 7]
    assert len(found.left_out) == 5


def test_nothing_that_connects_is_lost_and_no_link_becomes_too_long():
    rng = np.random.default_rng(0)
    before = drives.drive(10.0, 8, rng, alone=0.8).detected
    after = select_keyframes(before)
    assert 0.1 < len(after.left_out) / len(kept_of(before)) < 0.7

    def pairs(detected):
        frames = [detected.ids[detected.frame == k].tolist() for k in kept_of(detected)]
        return {(a, b) for ids in frames for a in ids for b in ids}

    assert pairs(after) == pairs(before)
    seconds = np.array([float(time) for time in before.times])
    gaps, was = np.diff(seconds[kept_of(after)]), np.diff(seconds[kept_of(before)])
    np.testing.assert_allclose(np.sort(gaps[gaps > LONGEST + 1e-9]), np.sort(was[was > LONGEST + 1e-9]))
