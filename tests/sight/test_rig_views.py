from examples import examples
from hypothesis import given
from numpy.testing import assert_array_equal
from rigs import rig_scenes_with_deployments

from lmd.sight import reference
from lmd.sight.evaluator import Evaluator


@examples(60)
@given(rig_scenes_with_deployments())
def test_a_rig_counts_what_the_reference_counts(case):
    scene, deployment = case
    assert_array_equal(Evaluator(scene, threads=1).counts(deployment), reference.counts(scene, deployment))


@examples(40)
@given(rig_scenes_with_deployments(fiducial=True))
def test_a_rig_counts_what_the_reference_counts_of_tags(case):
    scene, deployment = case
    assert_array_equal(Evaluator(scene, threads=1).counts(deployment), reference.counts(scene, deployment))
