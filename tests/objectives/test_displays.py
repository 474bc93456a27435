"""Figures in displays: a label and a unit for each, and the fitness by one name."""

import pytest
from support.small import problem

from lmd.objectives.base import labelled_figures
from lmd.objectives.coverage import MeanCoverage
from lmd.objectives.localisation import Localisation
from lmd.objectives.sampling import Sampling
from lmd.problem import Problem
from lmd.scene.deployment_sources import RandomDeployment


@pytest.mark.parametrize(
    ("key", "value", "label", "text"),
    [
        ("predicted_error_median", 0.00962, "predicted error, median", "9.6 mm"),
        ("localised_share_20mm", 0.31, "views localised to 20 mm", "31.00%"),
        ("wall_time", 1.17112, "wall time", "1.2 s"),
        ("evaluations", 1_200_000, "evaluations", "1,200,000"),
        ("lattice_gap", 0.0123, "fitness below that bound", "1.23%"),
        ("fitness_without_two_mean", 0.5, "fitness without two, mean", "50.00%"),
        ("grid_free_worst_crowd_qualified_ratio", 0.25, "qualified ratio, worst crowds, off the grid", "25.00%"),
        ("grid_free_average_coverage_probability", 0.5, "average probability, off the grid", "50.00%"),
        ("my_own", 3.5, "my own", "3.5"),
    ],
)
def test_a_figure_has_a_label_and_a_unit(key, value, label, text):
    assert labelled_figures({key: value}) == {label: text}


@pytest.mark.parametrize(
    ("objective", "figures", "first"),
    [
        (MeanCoverage(2, 0.5), {"average_coverage_probability": 0.4}, "40.00%, the average probability"),
        (
            Localisation(2, 0.5, sampling=Sampling(positions=1, divisions=1)),
            {"localised_share": 0.45, "worst_positions": 0.0},
            "40.00%, the localised share at the random poses of the search",
        ),
    ],
)
def test_the_fitness_comes_first_and_says_which_figure_it_is(objective, figures, first):
    scene = problem().scene
    known = {"fitness": 0.4, "qualified_ratio": 0.1, "maximum_coverage_probability": 0.9, **figures}
    own = Problem(scene, objective, RandomDeployment(30), threads=1)
    assert next(iter(own.describe(known, 30).items())) == ("fitness", first)
