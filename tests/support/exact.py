"""Fast paths against the reference, to the bit."""

from numpy.testing import assert_array_equal

from lmd.objectives.filtered import Filtered
from lmd.objectives.filtered.evaluation import (
    filtered_poses,
    frame_information,
    reference_filter,
    reference_information,
)
from lmd.objectives.localisation import Localisation
from lmd.objectives.localisation.evaluation import localised_views
from lmd.sight.evaluator import Evaluator


def found(case, evaluator):
    """All that an evaluation finds of a case, as arrays."""
    scene, hung, asked = case.scene, case.deployment, case.objective
    if isinstance(asked, Localisation):
        return localised_views(
            evaluator, hung.positions[None], hung.normals[None], asked.n, asked.precision(scene), keep=True
        )
    if not isinstance(asked, Filtered):
        return [evaluator.counts(hung)]
    arguments, drives, limits = (hung, asked.asked(scene), asked.n, asked.drives), asked.drives, asked.limits(scene)
    if evaluator.by_reference:
        information = reference_information(scene, *arguments)
        return *information, *reference_filter(drives, information, limits)
    information = frame_information(evaluator, *arguments)
    return *information, *filtered_poses(drives, information, limits)


def check_exact(case):
    """Fast paths find what the reference finds, to the bit."""
    slow, fast = Evaluator(case.scene, by_reference=True), Evaluator(case.scene, threads=1)
    for one, other in zip(found(case, slow), found(case, fast), strict=True):
        assert_array_equal(one, other)
    assert_array_equal(case.values(slow), case.values(fast))
