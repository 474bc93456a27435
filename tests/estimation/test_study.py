from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.paper import paper_room, paper_scene

from lmd.core.checks import InputError
from lmd.estimation.cramer_rao import CramerRaoBound
from lmd.estimation.estimators import Errors, pose_errors
from lmd.estimation.flights import Pace, RandomMotion
from lmd.estimation.observer import Observer
from lmd.estimation.sensors import PointDetector
from lmd.estimation.study import Flights, FlightStudy, InitialError, Outcome, conduct, to_markdown
from lmd.geometry import se3
from lmd.objectives.coverage import Coverage
from lmd.problem import Problem
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment

SCENE = paper_scene(paper_room(spacing=3.0))
MOTION = RandomMotion(4.0, Pace(1.0, 1.0, 10.0))
INITIAL = InitialError(position=0.7, attitude=0.5)


def problem(source):
    return Problem(SCENE, Coverage(2, 0.5), source, threads=1)


PROBLEMS = {"uniform": problem(UniformDeployment(60)), "random": problem(RandomDeployment(60))}
ESTIMATORS = {"observer": Observer(), "bound": CramerRaoBound()}


def flights(*seeds):
    return Flights.draw(PROBLEMS["uniform"], MOTION, INITIAL, seeds)


def errors_over_time(values):
    values = np.array(values, dtype=float)[None]
    return Errors(values, 2.0 * values, 3.0 * values)


def study_of(values, initial=1.0, squares=None):
    errors = replace(errors_over_time(values), squares=squares)
    counts = np.arange(errors.frobenius.size)[None]
    outcome = Outcome(counts, {n: np.array([0.1 * n]) for n in (1, 2, 3, 4)}, {"observer": errors})
    return FlightStudy([7], np.arange(errors.frobenius.size) * 0.5, np.array([initial]), {"mine": outcome})


def test_errors_are_those_of_the_poses():
    true = se3.camera_pose([[1.0, 2.0, 3.0]] * 2, [0.1, 0.2], [0.0, 0.3])
    estimated = true @ se3.exp(np.array([[0.0, 0.0, 0.2, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.3, 0.4]]))
    errors = pose_errors(true[None], estimated[None])
    assert_allclose(errors.attitude, [[0.2, 0.0]], atol=1e-12)
    assert_allclose(errors.position, [[0.0, 0.5]], atol=1e-12)
    assert_allclose(errors.frobenius, [[4.0 * (1.0 - np.cos(0.2)), 0.25]])


def test_the_first_estimate_is_as_wrong_as_said():
    drawn = flights(0, 1, 2)
    true = np.stack([trajectory.poses[0] for trajectory in drawn.trajectories])
    errors = pose_errors(true[None], drawn.start[None])
    assert_allclose(errors.position, 0.7)
    assert_allclose(errors.attitude, 0.5)


def test_every_deployment_has_the_same_flights_and_seeds_do_not_mix():
    together, alone = (
        conduct(PROBLEMS, flights(*s), dict.fromkeys(PROBLEMS, PointDetector(0.5, 0.1)), ESTIMATORS, False)
        for s in ((3, 4), (4,))
    )
    assert list(together.outcomes) == ["uniform", "random"]
    for name, outcome in together.outcomes.items():
        assert_array_equal(outcome.counts[1], alone.outcomes[name].counts[0])
        one, other = outcome.errors["observer"].frobenius[1], alone.outcomes[name].errors["observer"].frobenius[0]
        assert_allclose(one, other, rtol=1e-9)
    first = [outcome.errors["observer"].frobenius[:, 0] for outcome in together.outcomes.values()]
    assert_allclose(*first)
    assert_allclose(first[0], together.initial)


def test_a_random_deployment_is_another_for_each_seed():
    drawn = flights(0, 1)
    random, uniform = (PROBLEMS[name] for name in ("random", "uniform"))
    landmarks = np.stack([flight.deployment.positions for flight in drawn.over(random)])
    assert_array_equal(landmarks[1], random.start.draw(SCENE.room, np.random.default_rng(1)).positions)
    assert not np.allclose(landmarks[0], landmarks[1])
    same = [flight.deployment.positions for flight in drawn.over(uniform)]
    assert_array_equal(same[0], same[1])


def test_with_all_visible_each_deployment_is_flown_twice():
    study = conduct(
        {"mine": PROBLEMS["uniform"]}, flights(0), {"mine": PointDetector()}, {"observer": Observer()}, True
    )
    assert list(study.outcomes) == ["mine", "mine all visible"]
    seen, everything = study.outcomes.values()
    assert (everything.counts == 60).all()
    assert seen.counts.max() < 60
    assert_allclose(everything.shares[4], 1.0)
    assert everything.errors["observer"].frobenius[0, -1] < seen.errors["observer"].frobenius[0, -1]


def test_the_figures_of_a_flight():
    row = study_of([1.0, 0.5, 0.02, 0.001, 0.005, 0.002]).figures().iloc[0]
    assert (row.deployment, row.estimator, row.seed) == ("mine", "observer", 7)
    assert_allclose(row.settling_time, 1.5)
    assert_allclose(row.mean_error, np.mean([1.0, 0.5, 0.02, 0.001, 0.005, 0.002]))
    assert_allclose(row.position_error, 2.0 * 0.002)
    assert_allclose(row.attitude_error, 3.0 * 0.002)
    assert (row.available, row.mean_visible, row.share_visible_3) == (1.0, 2.5, 0.1 * 3)
    assert np.isnan([row.nees_joint, row.nees_rotation, row.nees_position]).all()


def test_the_normalised_errors_of_a_flight():
    squares = np.array([[600.0, 600.0, 600.0], [1.0, 1.0, 1.0], [9.0, 6.0, 3.0], [np.nan, np.nan, np.nan]])
    study = study_of([1.0, 0.5, 0.02, np.nan], squares=squares[None])
    row = study.figures().iloc[0]
    assert (row.nees_joint, row.nees_rotation, row.nees_position) == (1.5, 2.0, 1.0)
    assert "| 1.5 / 2 / 1 |" in to_markdown(study.figures(), 3)


@pytest.mark.parametrize(
    ("values", "settled"),
    [
        ([1.0, 0.001, 0.5, 0.001], 1.5),
        ([1.0, 0.001, 0.001, 0.5], np.inf),
        ([0.001, 0.001, 0.001, 0.001], 0.0),
        ([1.0, 0.001, np.nan, 0.001], np.inf),
    ],
)
def test_settled_means_for_good(values, settled):
    assert study_of(values).figures().settling_time[0] == settled


def test_frames_without_an_estimate_are_left_out():
    row = study_of([np.nan, 1.0, np.nan, 3.0]).figures().iloc[0]
    assert (row.mean_error, row.position_error, row.available) == (2.0, 6.0, 0.5)
    nothing = study_of([np.nan] * 4)
    assert np.isnan(nothing.figures().mean_error[0])
    assert nothing.curves().error_median.isna().all()


def test_curves_have_a_window_for_each_frame_or_several():
    short = study_of([4.0, 3.0, 2.0]).curves()
    assert_allclose(short.time, [0.0, 0.5, 1.0])
    assert_allclose(short.position_median, [8.0, 6.0, 4.0])
    long = study_of(np.arange(900.0)).curves()
    assert len(long) == 300
    assert_allclose(long.error_median, np.arange(1.0, 900.0, 3.0))
    assert (long.error_low < long.error_median).all()
    assert (long.error_median < long.error_high).all()


def test_the_table_has_a_row_for_each_deployment_and_estimator():
    study = conduct(PROBLEMS, flights(0, 1), dict.fromkeys(PROBLEMS, PointDetector(0.5)), ESTIMATORS, False)
    lines = to_markdown(study.figures(), 2).splitlines()
    assert [line.split(" | ")[:2] for line in lines[2:]] == [
        [f"| {name}", estimator] for name in PROBLEMS for estimator in ESTIMATORS
    ]
    assert "time with >= 2 in view | time with >= 3 in view" in lines[0]
    assert to_markdown(study.figures(), 3).count(" in view") == 1


def test_bad_input_gets_one_sentence():
    with pytest.raises(InputError, match=r"^estimators must name at least one estimator"):
        conduct(PROBLEMS, flights(0), dict.fromkeys(PROBLEMS, PointDetector()), {}, False)
    with pytest.raises(InputError, match=r"^attitude must be in \[0, 3\.14159\], got 4"):
        InitialError(1.0, 4.0)
