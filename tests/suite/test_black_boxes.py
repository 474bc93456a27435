"""Problems as functions on the unit box."""

import numpy as np
import pytest
from support.tables import refusals

import lmd
import lmd.suite
from lmd.core.checks import InputError
from lmd.suite.black_box import IMPOSSIBLE
from lmd.suite.several import HUNG


@pytest.fixture(scope="module")
def box():
    return lmd.suite.problem("tiny_mean")


def test_a_value_is_the_fitness_of_the_deployment(box):
    genes = box.start(seed=3)
    assert genes.shape == (box.dim,) == (16,)
    assert box(genes) == box.problem.fitness_of(box.deployment(genes))
    assert box(genes) == box.score(genes)["fitness"]
    assert 0.0 < box.score(genes)["grid_free_average_coverage_probability"] < 1.0


def test_a_batch_has_the_values_of_its_candidates(box):
    genes = np.random.default_rng(0).random((5, box.dim))
    assert box(genes).shape == (5,)
    assert box(genes).tolist() == [box(row) for row in genes]


def test_starts_depend_on_their_seed_alone(box):
    assert (box.start(1) == box.start(1)).all()
    assert (box.start(1) != box.start(2)).any()


@pytest.mark.parametrize("name", ["tiny_mean", "localised_against_tags", "coverage_against_accuracy"])
def test_no_candidates_have_no_values_and_a_seed_is_a_whole_number(name):
    box = lmd.suite.problem(name)
    assert box(np.empty((0, box.dim))).shape == ((0,) if len(box.objectives) == 1 else (0, 2))
    with pytest.raises(InputError, match=r"seed must be in \[0, "):
        box.start(-1)


def test_one_candidate_is_scored_at_a_time(box):
    with pytest.raises(InputError, match=r"genes must have the shape \(16,\), got \(2, 16\)"):
        box.score(np.zeros((2, 16)))


def test_papers_that_find_no_room_have_a_value_below_all_others():
    room = lmd.Cuboid(size=(1.0, 1.0, 1.0), reachable_size=(0.2, 0.2, 0.2), spacing=0.2, walls=("x_min",))
    camera = lmd.Camera(focal_length=3.6, pixel_width=0.0065, pixel_height=0.0065, principal_point=(320, 240),
                        image_width=640, image_height=480, aperture=1.5)  # fmt: skip
    tag = lmd.Tag(edge=0.2, quiet_zone=0.0)
    scene = lmd.Scene(room, camera, lmd.pdf.level_flight(), lmd.Fiducial(tag), tag)
    box = lmd.suite.BlackBox(lmd.Problem(scene, lmd.Coverage(n=1, thold_p=0.5), lmd.RandomDeployment(count=13)))
    values = box(np.random.default_rng(0).random((40, box.dim)))
    assert ((values == IMPOSSIBLE) | ((values >= 0.0) & (values <= 1.0))).all()
    assert (values == IMPOSSIBLE).any()


def test_two_objectives_are_those_of_two_problems():
    box = lmd.suite.problem("coverage_against_accuracy")
    genes = np.stack([box.start(seed) for seed in range(3)])
    values = box(genes)
    assert values.shape == (3, 2)
    for column, single in enumerate(box.boxes):
        assert values[:, column].tolist() == [single.problem.fitness_of(box.deployment(row)) for row in genes]


def test_tags_that_are_left_over_count_and_hide_nothing():
    box = lmd.suite.problem("localised_against_tags")
    genes = box.start(0)
    places, tags = genes[: -box.problem.count], np.zeros(box.problem.count)
    tags[[2, 5, 7]] = HUNG
    value = box(np.concatenate([places, tags]))
    hung = box.deployment(np.concatenate([places, tags]))
    assert len(hung) == 3
    assert value.tolist() == [box.problem.fitness_of(hung), pytest.approx(21 / 24)]
    moved = places.reshape(-1, 2).copy()
    moved[tags < HUNG] = 0.5
    assert box(np.concatenate([moved.ravel(), tags])).tolist() == value.tolist()
    assert box(np.concatenate([places, np.zeros_like(tags)])).tolist() == [0.0, 1.0]


def valued(value, shape):
    return lmd.suite.problem("tiny_mean")(np.full(shape, value))


test_what_cannot_be_is_refused_in_one_sentence = refusals(__file__, genes=valued)
