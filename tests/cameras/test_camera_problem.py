"""Placing cameras: the fitness is that of the rig, and every method climbs it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.paper import experiment_room, paper_camera, paper_scene
from support.small import make, marked

from lmd.cameras.body import Body
from lmd.cameras.mounts import MountSpace
from lmd.cameras.problem import CameraProblem
from lmd.core.checks import InputError
from lmd.formats.rigs import read_mounts, rig_of, write_rig
from lmd.objectives.base import AtLeast
from lmd.objectives.coverage import Coverage, MeanCoverage
from lmd.objectives.localisation import Localisation
from lmd.objectives.sampling import Sampling
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.rig import Rig
from pipelines.app import CONF

CAMERA, OTHER = paper_camera(), paper_camera(focal_length=8.0)
BODY = Body([{"low": [-0.2, -0.15, 0.0], "high": [0.2, 0.15, 0.2]}])
TAGS_ONLY = {"annealing", "gradient_ascent", "greedy", "milp"}
NAMES = {path.stem for path in Path(CONF, "optimiser").glob("*.yaml")} - TAGS_ONLY


def tagged(objective=None, count=12):
    scene = paper_scene(experiment_room(spacing=0.9), orientations=pdf.level_flight(4))
    return Problem(scene, objective or Coverage(2, 0.5), RandomDeployment(count), threads=1)


def problem(objective=None, count=2, start=None, tags=None, lenses=(CAMERA,), body=BODY):
    given = tagged(objective)
    tags = given.draw(np.random.default_rng(3)) if tags is None else tags
    return CameraProblem(given, tags, MountSpace(body, lenses, count, roll=(-0.3, 0.3)), start)


LOCALISATION = Localisation(1, tolerance=1.0, sampling=None)


class Squared(AtLeast):
    """An objective of somebody else's: no count of landmarks alone."""

    sampling = None

    def values(self, evaluator, positions, normals):
        return Coverage.values(self, evaluator, positions, normals) ** 2

    def fitness(self, values, relevance):
        return (values * relevance).sum(axis=-1) / relevance.sum()


@pytest.mark.parametrize(
    "objective",
    [Coverage(2, 0.5), MeanCoverage(1, 0.5), Coverage(2, 0.3, Sampling(2, 3)), Squared(2, 0.5), LOCALISATION],
    ids=["grid", "mean", "robust", "own", "localisation"],
)
def test_the_fitness_is_that_of_the_rig_to_the_bit(objective):
    p, rng = problem(objective, count=3, lenses=(CAMERA, OTHER)), np.random.default_rng(4)
    found = []
    for _ in range(4):
        genes = p.draw_genes(rng)
        found.append(p.fitness_of_genes(genes[None])[0])
        assert found[-1] == p.with_rig(p.rig(genes)).fitness_of(p.tags)
    assert len(set(found)) > 1


def test_the_counts_are_those_of_the_rig():
    p = problem(count=2)
    mounts = p.rig(p.draw_genes(np.random.default_rng(5))).mounts
    evaluator = p.with_rig(Rig(mounts)).evaluator
    for n in (1, 2, 4):
        whole = evaluator.units(p.tags.positions[None], p.tags.normals[None], n)[0]
        np.testing.assert_array_equal(p.views.units(mounts, n), whole)


def test_only_a_camera_that_moved_is_looked_at_anew():
    p, rng = problem(count=3), np.random.default_rng(6)
    genes = p.draw_genes(rng).reshape(3, -1)
    p.fitness_of_cameras(p.space.mounts(genes))
    known = [p.views.knows(mount) for mount in p.space.mounts(genes)]
    moved = genes.copy()
    moved[1] = p.space.draw(rng)[0]
    mounts = p.space.mounts(moved)
    assert known == [True] * 3
    assert [p.views.knows(mount) for mount in mounts] == [True, False, True]


@pytest.mark.parametrize("name", marked(NAMES))
def test_every_black_box_and_our_own_method_place_cameras(name):
    p = problem()
    result = make(name).run(p, Budget(40))
    assert result.evaluations <= 40
    assert result.fitness == p.with_rig(result.rig).metrics(result.deployment)["fitness"] > 0.0
    assert result.deployment is not None
    np.testing.assert_array_equal(result.deployment.positions, p.tags.positions)
    best = [record.best_fitness for record in result.history]
    assert best == sorted(best)


def test_annealing_records_an_improvement_at_the_move_that_made_it(monkeypatch):
    optimiser, p = make("camera_annealing"), problem(count=3)
    scored, score = [], optimiser._scored
    monkeypatch.setattr(optimiser, "_scored", lambda *given: (scored.append(score(*given)), scored[-1])[1])
    history = optimiser.run(p, Budget(20)).history
    best = np.maximum.accumulate([fitness for fitness, _ in [scored[0], *scored[2:]]])  # the second is the start again
    moves = np.flatnonzero(np.diff(best, prepend=-np.inf) > 0.0)
    first = {record.best_fitness: record.evaluations for record in reversed(history)}
    assert list(first.values())[::-1] == pytest.approx(1 + moves / 3)
    assert any(evaluations % 1.0 for evaluations in first.values())


def test_annealing_beats_random_search_at_the_same_cost():
    ours, random = (make(name).run(problem(MeanCoverage(2, 0.5), 3), Budget(60)) for name in
                    ("camera_annealing", "random_search"))  # fmt: skip
    assert ours.fitness > random.fitness


@pytest.mark.parametrize("name", ["camera_annealing", "ega"])
def test_a_start_is_never_made_worse(name):
    p = problem()
    first = make("camera_annealing").run(p, Budget(40))
    again = make(name, seed=1).run(problem(start=first.rig), Budget(10))
    assert again.fitness >= first.fitness


def test_methods_are_for_landmarks_or_for_cameras():
    for name in sorted(TAGS_ONLY):
        with pytest.raises(InputError, match=r"places landmarks, not cameras"):
            make(name).check(problem())
    with pytest.raises(InputError, match=r"^CameraAnnealing places cameras, not landmarks"):
        make("camera_annealing").check(tagged())


def test_a_body_that_leaves_the_room_is_refused_also_where_it_carries_no_camera():
    low, top = [-0.2, -0.2, 0.0], {"low": [-0.2, -0.2, 0.1], "high": [0.2, 0.2, 0.9], "name": "mast", "faces": []}
    with pytest.raises(InputError, match=r"^boxes: the body is not inside the room: rig has a camera at"):
        problem(body=Body([{"low": low, "high": [0.2, 0.2, 0.1]}, top]))


def test_a_camera_that_leaves_the_room_between_the_corners_of_its_body_has_no_fitness():
    p = problem()
    (mount, *_) = p.rig(p.draw_genes(np.random.default_rng(0))).mounts
    assert p.fitness_of_cameras([replace(mount, translation=(0.0, 0.0, 0.9))]) == -np.inf


def test_a_rig_file_has_the_rig_to_the_bit(tmp_path):
    p = problem(count=3)
    rig = p.rig(p.draw_genes(np.random.default_rng(8)))
    turned = Rig((*rig.mounts, replace(rig.mounts[0], yaw=0.0, pitch=0.0, roll=0.0, quaternion=(0.6, 0.0, 0.0, 0.8))))
    write_rig(tmp_path / "rig.yaml", turned, {})
    assert rig_of(read_mounts(tmp_path / "rig.yaml"), CAMERA) == turned
    write_rig(tmp_path / "own.yaml", rig, {CAMERA: {"path": "chain.yaml", "name": "cam1"}})
    assert [entry["camera"]["name"] for entry in read_mounts(tmp_path / "own.yaml")] == ["cam1"] * 3
    (tmp_path / "none.yaml").write_text("rig: 1")
    with pytest.raises(InputError, match=r"^rig: .* has no list of cameras with the key rig"):
        read_mounts(tmp_path / "none.yaml")
