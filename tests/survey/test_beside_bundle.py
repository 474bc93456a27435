"""A survey beside a plain bundle adjustment that shares no code with it."""

import sys
from pathlib import Path

import numpy as np
import pytest
from support import walks

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
import bundle  # a script


@pytest.mark.thorough("lmd/adjust", "lmd/survey")
def test_both_find_the_same_map():
    rng = np.random.default_rng(3)
    hung = walks.hung(walks.spaced_tags(16, rng), rng)
    detected = walks.photographed(hung, walks.walk(80, rng), rng)
    camera = walks.CAMERA
    numbers = np.array([*camera.focal_pixels, *(np.array(camera.principal_point) - 0.5), 0.0, 0.0, 0.0, 0.0])
    plain = bundle.adjust(
        detected.frame, detected.camera, detected.ids, detected.corners - 0.5, [bundle.Lens(numbers, False)], walks.EDGE
    )
    found = walks.surveyed(detected, calibrate=False)
    assert found.placed.all()
    np.testing.assert_array_equal(found.ids, plain.ids)
    # Both use the same corners, so they differ by less than their standard deviations.
    assert (walks.apart(found.found.poses.tags, plain.tags) < found.found.sigmas).all()
    assert 0.15 < plain.rms < 0.22
