from dataclasses import replace

import numpy as np
import pytest
from contracts.field import check_field, check_rebuilt, move, poses_of
from hypothesis import given
from hypothesis import strategies as st
from support.paper import paper_camera, paper_room, paper_scene
from support.strategies import BENT, FISHEYE, deployments, distorted_cameras, fiducial_scenes, is_bent, scenes, seeds
from support.thorough import examples

from lmd.core.checks import InputError
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation, localisation, reference
from lmd.objectives.localisation.evaluation import localised_views
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.fiducial import Fiducial

pytestmark = pytest.mark.long

TAG = Tag(0.1)


def objectives(*rotations, ambiguity="ignored", most=3):
    return st.builds(
        Localisation,
        n=st.integers(1, most),
        tolerance=st.sampled_from([0.005, 0.02, 0.1, 0.5, np.inf]),
        pixel_noise=st.sampled_from([0.2, 0.5]),
        rotation_tolerance=st.sampled_from(rotations),
        ambiguity=st.just(ambiguity),
        coverage_weight=st.sampled_from([0.0, 0.0, 0.3, 1.0]),
    )


tags = st.sampled_from([Tag(), Tag(0.1), Tag(0.3)])


def tagged(scene, tag):
    return Scene(scene.room, scene.camera, scene.pdf, scene.visibility, tag)


points_and_tags = st.builds(tagged, scenes(), tags)
bent_scenes = fiducial_scenes(distorted_cameras(BENT).filter(is_bent))
# What is asked of rotations or of a single tag, and what is seen, do not depend on each other, and every pair is
# compiled anew: each of both comes in one of the pairs. `test_sizes` asks for single tags without rotations.
cases = st.one_of(
    st.tuples(points_and_tags, objectives(None)),
    st.tuples(bent_scenes, objectives(0.003, 10.0, 10.0, ambiguity="resolved", most=1)),
)
other_cases = st.one_of(
    st.tuples(points_and_tags, objectives(None, ambiguity="resolved", most=1)),
    st.tuples(bent_scenes, objectives(0.003, 0.02, 10.0)),
    st.tuples(fiducial_scenes(distorted_cameras(FISHEYE)), objectives(None)),
)
other_pairs = pytest.mark.thorough("lmd/geometry", "lmd/incremental", "lmd/objectives/localisation", "lmd/sight")


def expected_units(scene, deployment, objective, positions):
    """L and P_n in units by the reference, `(P,)` each."""
    evaluator = Evaluator(scene, threads=1)
    axes, weights = scene.orientations.axes, evaluator.weights[0, : len(scene.orientations.axes)]
    covering = replace(objective, tolerance=np.inf, rotation_tolerance=None)
    return (
        np.array(
            [
                weights[reference.localised(scene, deployment, each.n, each.precision(scene), p, axes)].sum()
                for p in positions
            ]
        )
        for each in (objective, covering)
    )


@examples(100)
@given(data=st.data(), case=cases)
def test_views_are_localised_as_the_reference_says(data, case):
    check_views(data, *case)


@other_pairs
@examples(60)
@given(data=st.data(), case=other_cases)
def test_views_of_other_pairs_are_localised_as_the_reference_says(data, case):
    check_views(data, *case)


def check_views(data, scene, objective):
    deployment, positions = data.draw(deployments(scene.room)), scene.room.grid()
    landmarks = deployment.positions[None], deployment.normals[None]
    located, covered = expected_units(scene, deployment, objective, positions)
    for threads in (1, 3):
        evaluator = Evaluator(scene, threads=threads)
        views = localised_views(evaluator, *landmarks, objective.n, objective.precision(scene))
        np.testing.assert_array_equal(views.localised[0], located)
        np.testing.assert_array_equal(views.covered[0], covered)
    assert (located <= covered).all()


@given(data=st.data(), scene=points_and_tags, n=st.integers(1, 3))
def test_without_a_tolerance_it_is_coverage(data, scene, n):
    deployment, evaluator = data.draw(deployments(scene.room)), Evaluator(scene, threads=1)
    landmarks = deployment.positions[None], deployment.normals[None]
    values = Localisation(n, tolerance=np.inf, ambiguity="ignored").values(evaluator, *landmarks)
    np.testing.assert_array_equal(values, Coverage(n, 0.5).values(evaluator, *landmarks))


@examples(60)
@given(data=st.data(), case=cases, seed=seeds)
def test_after_any_moves_the_views_are_those_of_a_full_evaluation(data, case, seed):
    check_moves(data, *case, seed)


@other_pairs
@examples(60)
@given(data=st.data(), case=other_cases, seed=seeds)
def test_after_any_moves_in_other_pairs_the_views_are_those_of_a_full_evaluation(data, case, seed):
    check_moves(data, *case, seed)


def check_moves(data, scene, objective, seed):
    deployment, targets = data.draw(deployments(scene.room)), data.draw(deployments(scene.room, most=6))
    check_field(objective, scene, deployment, targets, np.random.default_rng(seed))


@pytest.mark.slow
@pytest.mark.parametrize("visibility", ["paper", "fiducial"])
def test_after_thousands_of_moves_the_sums_are_those_of_a_rebuild(visibility):
    scene, rng, count = replace(paper_scene(paper_room(spacing=1.0)), tag=TAG), np.random.default_rng(0), 60
    objective = Localisation()
    if visibility == "fiducial":
        lens = {"distortion": (-0.15, 0.02, 0.002, -0.003)}
        scene = replace(scene, visibility=Fiducial(TAG), camera=paper_camera(**lens))
        objective = replace(objective, n=1, rotation_tolerance=0.02)
    deployment = RandomDeployment(count).draw(scene.room, rng)
    evaluator = Evaluator(scene, threads=1)
    field = objective.field(evaluator)
    state = field.state(deployment)
    scratch = field.scratch(state)
    targets = RandomDeployment(2_000).draw(scene.room, rng)
    for i, pose in enumerate(poses_of(targets)):
        move(field, i % count, pose, targets.surfaces[i], state, scratch)
    check_rebuilt(objective, evaluator, field, state)


def test_two_points_never_localise_and_two_tags_do():
    points = paper_scene(paper_room(spacing=1.5))
    deployment = UniformDeployment(60).draw(points.room, np.random.default_rng())
    two = deployment[:2]
    for scene, landmarks, seen in (
        (points, two, False),
        (points, deployment, True),
        (replace(points, tag=TAG), two, True),
    ):
        values = Localisation(2, tolerance=0.5).values(
            Evaluator(scene, threads=1), landmarks.positions[None], landmarks.normals[None]
        )
        assert bool(values.max() > 0.0) == seen


def test_more_is_localised_with_a_wider_tolerance_less_noise_and_larger_tags():
    scene = paper_scene(paper_room(spacing=1.5))
    deployment = UniformDeployment(60).draw(scene.room, np.random.default_rng())

    def mean(edge=0.1, **changes):
        evaluator = Evaluator(replace(scene, tag=Tag(edge)), threads=1)
        return Localisation(**changes).values(evaluator, deployment.positions[None], deployment.normals[None]).mean()

    assert mean(tolerance=0.01) < mean() < mean(tolerance=0.05)
    assert mean(pixel_noise=1.0) < mean() < mean(edge=0.2)
    assert mean(tolerance=0.04, pixel_noise=1.0) == mean()  # only their ratio matters


@pytest.mark.parametrize(
    ("settings_", "message"),
    [
        ({"tolerance": 0.0}, "tolerance must be"),
        ({"pixel_noise": -1.0}, "pixel_noise must be"),
        ({"fitness": "median"}, "fitness must be one of"),
        ({"rotation_tolerance": 0.0}, "rotation_tolerance must be"),
        ({"coverage_weight": 1.5}, "coverage_weight must be"),
        ({"n": 0}, "n must be"),
        ({"ambiguity": "solved"}, "ambiguity must be one of"),
    ],
)
def test_bad_settings_are_refused(settings_, message):
    with pytest.raises(InputError, match=message):
        localisation(**settings_)


def test_figures_and_fitness_are_means_over_positions():
    values, relevance = np.array([0.2, 0.5, 0.8, 0.9]), np.array([1.0, 1.0, 1.0, 3.0])
    mean, share = Localisation(), Localisation(climbs="qualified", thold_p=0.5)
    assert mean.fitness(values, relevance) == pytest.approx((0.2 + 0.5 + 0.8 + 2.7) / 6.0)
    assert share.fitness(values, relevance) == pytest.approx(5.0 / 6.0)
    assert mean.figures(values, relevance)["localised_share"] == pytest.approx(0.6)
    assert mean.figures(values, relevance)["qualified_ratio"] == 0.75
    assert share.headline.key == "qualified_ratio"
