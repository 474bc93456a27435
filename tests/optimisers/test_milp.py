"""The integer program against all choices there are, scored by the kernels that every optimiser is scored by."""

import json
from dataclasses import replace
from itertools import combinations, combinations_with_replacement

import numpy as np
import pytest
from support.paper import paper_room, paper_scene
from support.processes import call, refused

from lmd.core.checks import InputError
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.objectives.sampling import Sampling
from lmd.optimisers.checkpoint import Checkpoint
from lmd.optimisers.ledger import Budget
from lmd.optimisers.milp import Milp
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.rig import Mount, Rig
from lmd.scene.tag import Tag
from lmd.sight.poses import candidate_poses
from lmd.space.space import Relevance

SPACING = 1.5
PLENTY = Budget(10_000)


def problem(count=3, n=2, thold_p=0.04, tag=None, fixed=None, start=None, relevance=None, occlusion="none"):
    room = paper_room(
        size=(3.0, 3.0, 2.5), reachable_size=(2.0, 2.0, 1.5), spacing=1.0, relevance=relevance or Relevance()
    )
    scene = replace(paper_scene(room, orientations=pdf.grid_with_ends(6), occlusion=occlusion), tag=tag)
    return Problem(scene, Coverage(n, thold_p), start or RandomDeployment(count), 1, fixed)


def best_of_all(p, spacing=SPACING):
    """The fitness of the best choice of poses: points in stacks that nothing hides, papers that do not overlap."""
    footprints = p.scene.footprints
    poses = candidate_poses(footprints.hanging, spacing)
    choices = combinations if footprints.edge else combinations_with_replacement
    chosen = np.array([
        each
        for each in choices(range(len(poses)), p.free_count)
        if not footprints.edge
        or not any(footprints.touched(poses[[i]], poses[[j]])[0] for i, j in combinations(each, 2))
    ])  # fmt: skip
    positions, normals = poses.positions[chosen], poses.normals[chosen]
    if p.fixed is not None:
        there = p.fixed.positions, p.fixed.normals
        positions, normals = (
            np.concatenate([np.broadcast_to(first, (len(chosen), *first.shape)), then], axis=1)
            for first, then in zip(there, (positions, normals), strict=True)
        )
    return p.fitness(positions, normals).max()


HERE = Relevance(regions=[{"low": [0.0, 0.0, 0.0], "high": [1.5, 1.5, 2.5], "weight": 3.0}])


@pytest.mark.parametrize(
    "setting",
    [
        {"n": 1, "count": 2, "thold_p": 0.25},
        {"n": 2, "relevance": HERE},
        {"n": 3, "thold_p": 0.02},
        {"n": 1, "thold_p": 0.0},
    ],
)
def test_what_is_proven_is_the_best_of_all_choices(setting):
    p, optimiser = problem(**setting), Milp(SPACING)
    result, best = optimiser.run(p, PLENTY), best_of_all(problem(**setting))
    assert result.stopped == "proven"
    assert 0.0 < best == pytest.approx(optimiser.figures()["lattice_bound"], abs=1e-12)
    assert result.fitness == problem(**setting).metrics(result.deployment)["fitness"] >= best
    assert optimiser.figures()["lattice_gap"] == pytest.approx(best - result.fitness, abs=1e-12)


def test_landmarks_that_hide_each_other_never_exceed_the_bound():
    optimiser = Milp(SPACING)
    result = optimiser.run(problem(occlusion="paper"), PLENTY)
    assert optimiser.figures()["lattice_bound"] >= max(best_of_all(problem(occlusion="paper")), result.fitness)


def test_what_hangs_already_counts():
    hangs = UniformDeployment(2).draw(problem().scene.room, np.random.default_rng(0))
    p, optimiser = problem(fixed=hangs, start=RandomDeployment(2)), Milp(SPACING)
    result = optimiser.run(p, PLENTY)
    np.testing.assert_array_equal(result.deployment.positions[:2], hangs.positions)
    assert optimiser.figures()["lattice_bound"] == pytest.approx(best_of_all(p), abs=1e-12)


def test_papers_of_tags_do_not_overlap():
    large, optimiser = Tag(1.2), Milp(1.0)
    p = problem(count=2, n=1, tag=large)
    result = optimiser.run(p, PLENTY)
    p.scene.footprints.check(result.deployment)
    assert optimiser.figures()["lattice_bound"] == pytest.approx(best_of_all(p, 1.0), abs=1e-12)


def test_without_time_there_is_a_bound_and_the_start():
    p, optimiser = problem(count=12, thold_p=0.5), Milp(0.5, seconds=0.3)
    result, figures = optimiser.run(p, Budget(100)), optimiser.figures()
    assert result.stopped == "budget"
    assert figures["lattice_found"] < figures["lattice_bound"] <= 1.0
    assert result.fitness >= p.fitness_of(p.draw(np.random.default_rng(0)))
    assert result.evaluations <= 100


def test_a_run_that_is_interrupted_begins_anew(tmp_path):
    p, optimiser, asked = problem(count=12, thold_p=0.5), Milp(0.5), iter(range(100))
    assert optimiser.run(p, PLENTY, lambda _: next(asked) == 1).stopped == "interrupted"
    Checkpoint(optimiser, {}).save(tmp_path)
    checkpoint = Checkpoint(Milp(0.5, seconds=0.3), {})
    checkpoint.resume(tmp_path, p)
    assert checkpoint.optimiser.run(p, PLENTY).evaluations > optimiser.ledger.evaluations == 1


def with_camera(p, camera):
    return Problem(replace(p.scene, camera=camera), p.objective, p.start, 1)


@pytest.mark.parametrize(
    ("change", "optimiser", "message"),
    [
        (
            lambda p: Problem(p.scene, Coverage(2, 0.5, Sampling(2, 4)), p.start, 1),
            Milp(),
            "needs the objective Coverage on",
        ),
        (lambda p: Problem(p.scene, Localisation(), p.start, 1), Milp(), "objective Coverage on the grid"),
        (
            lambda p: with_camera(p, Rig((Mount(p.scene.camera, (0.1, 0.0, 0.0)), Mount(p.scene.camera)))),
            Milp(),
            "a single camera, not a rig",
        ),
        (lambda p: p, Milp(0.02), r"has \d+ poses, 0.02 m apart, which makes .* views: at most 2e\+07"),
        (lambda _: problem(count=13), Milp(5.0), "has 6 poses, 5 m apart, too few for 13 landmarks"),
    ],
)
def test_what_does_not_fit_is_refused(change, optimiser, message):
    with pytest.raises(InputError, match=message):
        optimiser.check(change(problem(count=8)))


def test_a_budget_that_does_not_pay_for_the_lattice_is_refused():
    with pytest.raises(InputError, match=r"has \d+ poses: it costs .* but only 5 are left"):
        Milp(SPACING).run(problem(), Budget(5))


SETTINGS = ("experiment=debug", "room.spacing=2.2", "deployment.count=10", "optimiser=milp", "optimiser.spacing=2.5")


def test_the_bound_is_in_the_record(tmp_path):
    done = call(
        "optimise", *SETTINGS, "objective.n=1", "objective.thold_p=0.1", "hydra.run.dir=out", cwd=tmp_path, settings=()
    )
    assert done.returncode == 0, done.stderr
    document = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert document["stopped"] == "proven"
    assert document["lattice_gap"] == pytest.approx(document["lattice_bound"] - document["fitness"])
    assert "bound on the lattice" in done.stdout


def test_the_papers_room_is_refused_in_a_sentence(tmp_path):
    refused(
        "optimise", "optimiser=milp", "hydra.run.dir=out", message="m apart, which makes", cwd=tmp_path, settings=()
    )
