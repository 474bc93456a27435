import numpy as np
import pandas as pd
import pytest
from matplotlib.image import imread
from support import small
from support.paper import X

from lmd.evaluation.tradeoff import (
    ANEW,
    FEWER,
    MORE,
    Found,
    between,
    fewest,
    front,
    grown,
    improved,
    shrunk,
    started,
)
from lmd.plot.charts import Panel, save_tradeoff_figure
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment


def problem_of(count, **parts):
    return small.problem(RandomDeployment(count), **parts)


def drawn(problem, seed=0):
    return problem.draw(np.random.default_rng(seed))


def test_what_is_added_leaves_the_others_and_sees_more():
    few, more = problem_of(10), problem_of(14)
    deployment = drawn(few)
    larger = grown(more, deployment)
    assert len(larger) == 14
    np.testing.assert_array_equal(larger.positions[:10], deployment.positions)
    rng = np.random.default_rng(1)
    at_random = [more.values(deployment + more.draw(rng)[:4]).mean() for _ in range(10)]
    assert more.values(larger).mean() > max(at_random)


def test_the_one_that_is_missed_least_goes_first():
    problem = problem_of(3)
    positions = np.array([[0.0, 2.0, 3.0], [0.0, 2.5, 3.0], [0.0, 3.0, 3.0], [0.0, 2.5, 6.0]])
    deployment = Deployment(positions, np.array([X, X, X, X]))
    rests = [np.delete(np.arange(4), k) for k in range(4)]
    expected = max(rests, key=lambda rest: problem.fitness_of(deployment[rest]))
    np.testing.assert_array_equal(shrunk(problem, deployment).positions, positions[expected])


def test_what_hangs_already_stays():
    fixed = Deployment(np.array([[0.0, 2.0, 3.0], [0.0, 3.0, 3.0]]), np.array([X, X]))
    few, more = problem_of(2, fixed=fixed), problem_of(4, fixed=fixed)
    larger = grown(more, drawn(few))
    assert len(larger) == 6
    for deployment in (larger, shrunk(few, larger), drawn(started(few, shrunk(few, larger)))):
        np.testing.assert_array_equal(deployment.positions[:2], fixed.positions)


def test_neighbours_lend_what_they_have_found():
    """Searches that do nothing: all that is found is what neighbours give."""
    known = {count: Found(drawn(problem_of(count)), 0.0, ANEW) for count in (8, 10, 12)}
    good = drawn(problem_of(10), seed=9)
    known[10] = Found(good, 1.0, ANEW)
    ways = []

    def search(count, problem, way):
        assert count == problem.count
        ways.append((count, way))
        return Found(drawn(problem), 0.5, way)

    assert list(improved(known, [10], problem_of, lambda _, problem, way: Found(drawn(problem), 1.0, way))) == [10]
    found = improved(known, [8, 10, 12], problem_of, search)
    assert ways == [(10, FEWER), (12, FEWER), (10, MORE), (8, MORE)]
    assert {count: each.way for count, each in found.items()} == {8: MORE, 10: ANEW, 12: FEWER}
    np.testing.assert_array_equal(found[12].deployment.positions[:10], good.positions)
    assert {tuple(p) for p in found[8].deployment.positions} < {tuple(p) for p in good.positions}


def points_of(values, edge=0.1):
    """A table from `{count: figures of the seeds}`."""
    rows = [
        {"edge": edge, "count": count, "seed": seed, "share": share}
        for count, shares in values.items()
        for seed, share in enumerate(shares)
    ]
    return pd.DataFrame(rows)


SMALL = points_of({10: (0.2, 0.3, 0.4), 14: (0.5, 0.6, 0.7), 20: (0.8, 0.8, 0.9)})
LARGE = points_of({10: (0.6, 0.7, 0.8), 14: (0.7, 0.8, 0.9), 20: (0.9, 0.9, 0.9)}, edge=0.2)


def test_the_front_has_the_median_and_the_spread():
    row = front(pd.concat([SMALL, LARGE]), ["share"]).loc[(0.1, 14)]
    assert row.to_dict() == {"share": 0.6, "least": 0.5, "greatest": 0.7}


@pytest.mark.parametrize(
    ("wanted", "expected"),
    [(0.6, (14, 14, 20)), (0.85, (np.inf, 20, np.inf)), (0.1, (10, 10, 10)), (0.95, (np.inf, np.inf, np.inf))],
)
def test_the_fewest_by_the_median_and_by_single_seeds(wanted, expected):
    assert tuple(fewest(SMALL, "share", wanted).loc[0.1]) == expected


def test_the_gap_below_the_fewest_is_halved_until_it_is_one():
    both = pd.concat([SMALL, LARGE])
    assert between(both, "share", 0.6) == [(0.1, 12)]  # nothing is known below 10
    assert between(both, "share", 0.75) == [(0.1, 17), (0.2, 12)]
    closed = points_of({10: (0.2,), 11: (0.7,)})
    assert between(closed, "share", 0.6) == []
    assert between(SMALL, "share", 0.95) == []


def test_the_picture_has_a_panel_for_each_figure(tmp_path):
    save_tradeoff_figure(tmp_path / "a.png", pd.concat([SMALL, LARGE]), [Panel("a", "share"), Panel("b", "share")], "T")
    assert imread(tmp_path / "a.png").shape[:2] == (450, 1100)
