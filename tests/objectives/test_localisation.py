from dataclasses import replace

import numpy as np
import pytest
from contracts.field import check_rebuilt, move, poses_of
from support.paper import paper_camera, paper_room, paper_scene

from lmd.objectives.localisation import Localisation
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.fiducial import Fiducial

pytestmark = pytest.mark.long

TAG = Tag(0.1)


OTHERS = pytest.mark.thorough("lmd/incremental", "lmd/objectives/localisation", "lmd/sight")  # compiled for it alone
BENT = {"distortion": (-0.15, 0.02, 0.002, -0.003)}


@pytest.mark.parametrize(
    ("changes", "objective"),
    [
        pytest.param({"visibility": Fiducial(TAG)}, Localisation(1, tolerance=0.03), marks=OTHERS),
        pytest.param({}, Localisation(), marks=OTHERS),
        pytest.param(
            {"visibility": Fiducial(TAG), "camera": paper_camera(**BENT)},
            Localisation(1, rotation_tolerance=0.02),
            marks=OTHERS,
        ),
    ],
    ids=["sizes", "points", "lens"],
)
def test_after_thousands_of_moves_the_sums_are_those_of_a_rebuild(changes, objective):
    scene, rng, count = replace(paper_scene(paper_room(spacing=1.0)), tag=TAG, **changes), np.random.default_rng(0), 60
    if objective.tolerance == 0.03:
        scene = scene.sized(np.resize([0.05, 0.1, 0.3], count))
    field = objective.field(evaluator := Evaluator(scene, threads=1))
    state = field.state(RandomDeployment(count).draw(scene.room, rng))
    scratch, targets = field.scratch(state), RandomDeployment(2_000).draw(scene.room, rng)
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


def test_figures_and_fitness_are_means_over_positions():
    values, relevance = np.array([0.2, 0.5, 0.8, 0.9]), np.array([1.0, 1.0, 1.0, 3.0])
    mean, share = Localisation(), Localisation(climbs="qualified", thold_p=0.5)
    assert mean.fitness(values, relevance) == pytest.approx((0.2 + 0.5 + 0.8 + 2.7) / 6.0)
    assert share.fitness(values, relevance) == pytest.approx(5.0 / 6.0)
    assert mean.figures(values, relevance)["localised_share"] == pytest.approx(0.6)
    assert mean.figures(values, relevance)["qualified_ratio"] == 0.75
    assert share.headline.key == "qualified_ratio"
