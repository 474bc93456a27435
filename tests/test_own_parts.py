"""A criterion, an objective and a space of one's own, each a class that nothing in the library knows of."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from paper import paper_camera, paper_room, paper_scene
from paths import check_every_path
from strategies import deployments, rooms, seeds

from lmd.core.checks import InputError
from lmd.evaluation.bounds import Search, average_upper_bound
from lmd.evaluation.validation import Sample, validation_metrics
from lmd.objectives.base import Headline
from lmd.objectives.coverage import Coverage
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.base import Budget
from lmd.optimisers.ega import EGA
from lmd.optimisers.greedy import Greedy
from lmd.plot.scene import save_scene_figure
from lmd.problem import Problem
from lmd.run import optimise
from lmd.scene import pdf
from lmd.scene.criteria import TOLERANCE, from_position, hide, in_image, in_view
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import evaluate_range
from lmd.space.cuboid import Cuboid
from pipelines.evaluate import lose

pytestmark = pytest.mark.slow  # what is made for classes from elsewhere is compiled anew each time

LEAST_COSINE = 0.5  # of the incidence angle
WIDE, HIGH = 0.9, 0.4  # tangents of the half-angles of an image that is level
OUTER = 1.0 / math.sqrt(1.0 + WIDE**2 + HIGH**2)  # cosine of the angle to its corners


@dataclass(frozen=True)
class Rectangle:
    """Seen within a range, at an incidence of at most 60 degrees, inside a level rectangle; a near one hides."""

    range: float = 3.0
    size: float = 0.2
    spacing = 0.2
    needs_roll = False

    def sight(self, camera):
        return RectangleSight(self.range, self.size**2)

    def covered(self, camera, position, axes, landmarks, normals):
        offset = landmarks - position
        x, y, z = offset.T
        distance = np.sqrt(x * x + y * y + z * z)
        nx, ny, nz = normals.T
        seen = (distance <= self.range) & (-(nx * x + ny * y + nz * z) >= LEAST_COSINE * distance)
        squared = x * x + y * y + z * z
        across = np.array([[np.cross(b, a) @ np.cross(b, a) for a in offset] for b in offset])  # over: b hides a
        hidden = (across <= self.size**2 * squared) & (squared[:, None] + TOLERANCE < squared)
        ax, ay, az = axes.T[:3, :, None]
        depth = ax * x + ay * y + az * z
        level = np.sqrt(ax * ax + ay * ay)
        right = np.abs(ay * x - ax * y)
        up = np.abs(level * level * z - az * (ax * x + ay * y))
        inside = (depth > 0.0) & (right <= WIDE * depth * level) & (up <= HIGH * depth * level)
        return inside & (seen & ~hidden.any(axis=0))


class RectangleSight(NamedTuple):
    range: float
    reach: float

    @property
    def outer_cosine(self):
        return OUTER - TOLERANCE

    @property
    def inset(self):
        return 0.0

    @property
    def tabulated(self):
        return False

    def unhidden(self):
        return self._replace(reach=-1.0)

    def among(self, low, high, landmarks, normals):
        return self

    def shrunk(self, size):
        return self._replace(reach=self.reach * size**2)


@from_position.register(RectangleSight)
def _from_position(sight, x, y, z, nx, ny, nz, slack):
    distance = math.sqrt(x * x + y * y + z * z)
    nearest = distance - slack
    facing = -(nx * x + ny * y + nz * z) >= LEAST_COSINE * nearest
    low = nearest / math.sqrt(1.0 + 0.9 * 0.9 + 0.4 * 0.4) * (1.0 - 1e-9) - slack
    return facing & (nearest <= sight.range), low, np.inf, -np.inf  # nothing is sure


@in_image.register(RectangleSight)
def _in_image(sight, x, y, z, nx, ny, nz, low, slack, ax, ay, az, rx, ry, rz):
    depth = ax * x + ay * y + az * z
    level = math.sqrt(ax * ax + ay * ay)
    right = abs(ay * x - ax * y)
    up = abs(level * level * z - az * (ax * x + ay * y))
    inside = (depth > 0.0) & (right <= 0.9 * depth * level) & (up <= 0.4 * depth * level)
    return inside & (low < np.inf)


@in_view.register(RectangleSight)
def _in_view(sight, x, y, z, sine, cosine, ax, ay, az, rx, ry, rz):
    return (sine < 0.0) & (ax * x + ay * y + az * z >= OUTER * cosine + sine)  # nothing is certain; a loose bound


@hide.register(RectangleSight)
def _hide(sight, ax, ay, az, a, bx, by, bz, b, ux, uy, uz, vx, vy, vz):
    cx = ay * bz - az * by
    cy = az * bx - ax * bz
    cz = ax * by - ay * bx
    cross = cx * cx + cy * cy + cz * cz
    return (cross <= sight.reach * b) & (a + 1e-9 < b), (cross <= sight.reach * a) & (b + 1e-9 < a)


def own_scene(room=None):
    return Scene(room or paper_room(spacing=1.5), paper_camera(), pdf.grid_of_cells(6), Rectangle())


@examples(30)
@given(data=st.data(), room=rooms(), n=st.integers(1, 3), seed=seeds)
def test_every_fast_path_counts_by_a_criterion_of_ones_own(data, room, n, seed):
    scene = own_scene(room)
    deployment, targets = data.draw(deployments(room)), data.draw(deployments(room, most=4))
    check_every_path(scene, deployment, targets, n, np.random.default_rng(seed))


def test_what_is_compiled_for_a_class_of_ones_own_does_not_spoil_the_cache_for_others():
    evaluator = Evaluator(own_scene(), threads=1)
    evaluator.counts(UniformDeployment(3).draw(paper_room(), np.random.default_rng()))
    index = evaluate_range._cache._cache_file._load_index()
    assert not [key for key in index if "RectangleSight" in str(key)]
    assert any("RectangleSight" in str(signature) for signature in evaluate_range.signatures)


@pytest.mark.parametrize("optimiser", [Annealing(), Greedy(spacing=1.0), EGA()])
def test_optimisers_climb_by_a_criterion_of_ones_own(optimiser):
    scene = own_scene()
    problem = Problem(scene, Coverage(2, 0.1), UniformDeployment(40), threads=1)
    start = problem.fitness_of(problem.start.draw(scene.room, np.random.default_rng()))
    assert optimise(problem, evaluations=300, optimiser=optimiser).fitness > start


@dataclass(frozen=True)
class MeanSeen:
    """The mean share of orientations in which any landmark is seen; no field, no selection."""

    sampling = None
    n = 1
    headline = Headline("seen", "seen at all")
    name, value_name, value_label, threshold = "any", "S", "share of orientations", 0.5

    def check(self, count):
        pass

    def values(self, evaluator, positions, normals):
        return evaluator.units(positions, normals, 1) / 2.0**52

    def qualified(self, values):
        return values >= self.threshold

    def fitness(self, values, relevance):
        return (values * relevance).sum(axis=-1) / relevance.sum()

    def shares(self, values):
        return {"seen": values}

    def figures(self, values, relevance):
        return {"seen": float(values.mean())}

    def field(self, evaluator):
        raise InputError("MeanSeen has no field that single moves could update; use a black box such as EGA.")

    selection = field


def test_a_black_box_climbs_an_objective_of_ones_own_and_the_rest_says_what_it_lacks(tmp_path, capsys):
    scene = paper_scene(paper_room(spacing=1.5), orientations=pdf.grid_with_ends(6))
    problem = Problem(scene, MeanSeen(), RandomDeployment(20), threads=1)
    result = optimise(problem, evaluations=200, optimiser=EGA())
    assert result.fitness > result.history[0].best_fitness
    assert problem.metrics(result.deployment) == {"seen": result.fitness, "fitness": result.fitness}
    off_grid = validation_metrics(problem, result.deployment, 0, Sample(4, 50, 8))
    assert set(off_grid) == {"finer_grid_seen", "grid_free_seen", "grid_free_seen_standard_error"}
    save_scene_figure(tmp_path / "scene.png", problem, result.deployment, "own")
    for method in (Annealing(), Greedy()):
        with pytest.raises(InputError, match=r"^MeanSeen has no field"):
            method.run(problem, Budget(50))
    assert lose(problem, problem.draw(np.random.default_rng(0))) is None
    assert capsys.readouterr().out.startswith("no losses: MeanSeen has no field")
    with pytest.raises(InputError, match=r"no upper bound for the objective MeanSeen"):
        average_upper_bound(problem, 20, Search(1.0, 10, 0.1))


class Shifted:
    """A cuboid that begins elsewhere: the same room in other coordinates, and so no room with a corner at 0."""

    SHIFT = np.array([8.0, -16.0, 4.0])  # exact in binary, so that nothing rounds differently

    def __init__(self, room):
        self._room, self.relevance = room, room.relevance

    def surfaces(self):
        return tuple(
            type(s)(s.name, s.origin + self.SHIFT, s.u, s.v, s.normal, s.extent) for s in self._room.surfaces()
        )

    def faces(self):
        return self.surfaces()

    def surfaces_of(self, positions, normals):
        return self._room.surfaces_of(positions - self.SHIFT, normals)

    def surface_near(self, positions, normals):
        return self._room.surface_near(positions - self.SHIFT, normals)

    def bounds(self):
        low, high = self._room.bounds()
        return low + self.SHIFT, high + self.SHIFT

    def contains(self, points):
        return self._room.contains(points - self.SHIFT)

    def blockers(self):
        return None

    def clear(self, starts, ends):
        return self._room.clear(starts, ends)

    def passable(self, starts, ends):
        return self._room.passable(starts, ends)

    def grid(self):
        return self._room.grid() + self.SHIFT

    def finer(self):
        return Shifted(self._room.finer())

    def jittered_grid(self, repeats, rng):
        return self._room.jittered_grid(repeats, rng) + self.SHIFT

    def sample(self, size, rng):
        return self._room.sample(size, rng) + self.SHIFT

    def sample_evenly(self, size, rng):
        return self._room.sample_evenly(size, rng) + self.SHIFT

    def outline(self):
        return {name: edges + self.SHIFT for name, edges in self._room.outline().items()}

    def fixtures(self):
        return ()

    def describe(self):
        return self._room.describe()


@pytest.mark.parametrize("optimiser", [Annealing, Greedy, EGA])
def test_a_space_of_ones_own_gives_what_the_same_room_gives_elsewhere(tmp_path, optimiser):
    room = Cuboid((4.0, 3.0, 2.5), (3.0, 2.0, 1.5), 0.5)
    results = []
    for space in (room, Shifted(room)):
        scene = paper_scene(space, orientations=pdf.grid_with_ends(6), thold=0.4)
        problem = Problem(scene, Coverage(2, 0.5), RandomDeployment(16), threads=1)
        result = optimise(problem, evaluations=100, optimiser=optimiser())
        save_scene_figure(tmp_path / "scene.png", problem, result.deployment, "own")
        off_grid = validation_metrics(problem, result.deployment, 0, Sample(4, 50, 8))
        results.append((result, off_grid))
    (here, near), (there, far) = results
    assert near["grid_free_qualified_ratio"] == pytest.approx(far["grid_free_qualified_ratio"], abs=0.05)
    assert here.fitness == pytest.approx(there.fitness, abs=0.1)
    assert (there.deployment.surfaces == Shifted(room).surfaces_of(there.deployment.positions, there.deployment.normals)
            ).all()  # fmt: skip
