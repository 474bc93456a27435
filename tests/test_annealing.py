import numpy as np
import pytest
from conftest import paper_room, paper_scene
from test_optimisers import make, problem

from lmd import pdf
from lmd.checks import InputError
from lmd.deployment import FileDeployment, RandomDeployment, UniformDeployment
from lmd.optimisers.annealing import Stage
from lmd.optimisers.base import Budget
from lmd.optimisers.walk import _reflect
from lmd.problem import CoverageProblem, Objective

PAIRS = {"temperature": [1e-3, 1e-4], "width": [0.1, 0.01], "step": [1.0, 0.1]}


def flush_on_walls(room, deployment):
    walls = room.landmark_walls()
    on = [np.abs((deployment.positions - w.origin) @ w.normal) < 1e-9 for w in walls]
    faces = [(deployment.normals == w.normal).all(axis=1) for w in walls]
    return (np.array(on) & np.array(faces)).any(axis=0).all()


@pytest.mark.parametrize(("count", "n"), [(30, 2), (31, 2), (31, 3), (4, 4), (5, 1)])
def test_every_landmark_ends_flush_on_an_allowed_wall(count, n):
    room = paper_room(spacing=1.5, walls=("x_min", "ceiling", "y_max"))
    scene = paper_scene(room=room, orientations=pdf.grid_with_ends(6))
    p = CoverageProblem(scene, Objective(n, 0.3), RandomDeployment(count), threads=1)
    result = make("annealing").run(p, Budget(300))
    assert len(result.deployment) == count
    assert flush_on_walls(room, result.deployment)
    assert result.evaluations == 300


def test_stacks_are_pulled_apart_by_the_spread():
    optimiser = make("annealing")
    p = problem()
    optimiser.run(p, Budget(300), lambda o: not o.in_stacks)
    pairs = optimiser.here.positions.reshape(-1, 2, 3)
    inside = ((pairs > 0.1) & (pairs < np.array(p.scene.room.size) - 0.1)).sum(axis=2).min(axis=1) >= 2
    distance = np.linalg.norm(pairs[:, 0] - pairs[:, 1], axis=1)
    np.testing.assert_allclose(distance[inside], 1.6 * 0.05)


def test_a_given_start_is_not_stacked(tmp_path):
    start = UniformDeployment(30)
    p = problem(start)
    start.draw(p.scene.room, np.random.default_rng()).to_csv(tmp_path / "start.csv")
    for source in (start, FileDeployment(str(tmp_path / "start.csv"))):
        optimiser = make("annealing")
        optimiser.run(problem(source), Budget(40), lambda _: True)
        assert not optimiser.in_stacks
        assert len(optimiser.here) == 30


def test_a_coordinate_beyond_a_wall_is_folded_back():
    assert [_reflect(v, 2.0) for v in (0.5, -0.5, 2.5, 4.5, -4.5)] == [0.5, 0.5, 1.5, 0.5, 0.5]


def test_conditions_run_geometrically_from_first_to_last():
    stage = Stage(**PAIRS)
    assert stage.climate(0.0, 0.1).temperature == 1e-3
    assert stage.climate(0.5, 0.1).temperature == pytest.approx(np.sqrt(1e-7))
    assert stage.climate(1.0, 0.1).step == pytest.approx(0.1)
    assert stage.climate(2.0, 0.1).width == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"temperature": [1.0]}, r"optimiser\.temperature must be a list of 2 numbers"),
        ({"width": [0.1, 0.0]}, r"optimiser\.width\[1\] must be greater than 0"),
        ({"jump": 0.7, "join": 0.5}, r"optimiser\.join must be in \[0, 0\.3\], got 0\.5"),
    ],
)
def test_impossible_conditions_are_refused(values, message):
    with pytest.raises(InputError, match=message):
        Stage(**(PAIRS | values))
