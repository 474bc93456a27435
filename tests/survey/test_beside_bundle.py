"""A survey beside a plain bundle adjustment that shares no code with it."""

import sys
from pathlib import Path

import numpy as np
import walks

from lmd.scene.tag import Tag
from lmd.survey.prior import Known
from lmd.survey.survey import survey

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
import bundle  # a script


def test_both_find_the_same_map():
    rng = np.random.default_rng(3)
    hung = walks.hung(walks.spaced_tags(16, rng), rng)
    detected = walks.photographed(hung, walks.walk(80, rng), rng)
    camera = walks.CAMERA
    numbers = np.array([*camera.focal_pixels, *(np.array(camera.principal_point) - 0.5), 0.0, 0.0, 0.0, 0.0])
    plain = bundle.adjust(
        detected.frame, detected.camera, detected.ids, detected.corners - 0.5, [bundle.Lens(numbers, False)], walks.EDGE
    )
    found = survey(detected, [camera], Tag(walks.EDGE), walks.constant_errors(0.2), Known(), calibrate=False)
    here, there = found.found.poses.tags[:, :3, 3], plain.tags[:, :3, 3]
    assert found.placed.all()
    np.testing.assert_array_equal(found.ids, plain.ids)
    a, b = here - here.mean(axis=0), there - there.mean(axis=0)
    left, _, right = np.linalg.svd(a.T @ b)
    apart = np.linalg.norm(a @ left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right - b, axis=1)
    # Both use the same corners, so they differ by less than either is sure of.
    assert (apart < found.found.sigmas).all()
    assert 0.15 < plain.rms < 0.22
