"""`deployment.count=[4,2]` and `tag.paper` on the command line."""

import json

import numpy as np
import pandas as pd
import pytest
from support.composing import composed
from support.processes import inside

from lmd.optimisers.ledger import Budget
from pipelines.building import build_optimiser, build_problem
from pipelines.study import derived

SIZES = ("tag.edge=0.1", "tag.edges=[0.06,0.20]")
TAGS = "id,x,y,z,nx,ny,nz\n7,0,2,3,1,0,0\n3,0.02,3,3,1,0,0\n"


@pytest.fixture(autouse=True)
def _in_a_folder_with_tags(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tags.csv").write_text(TAGS)


def built(*overrides):
    cfg = composed("optimise", "room.spacing=1.5", *overrides)
    return build_problem(cfg), cfg


@pytest.mark.parametrize("source", ["random", "uniform", "greedy"])
def test_counts_by_size_are_those_of_the_landmarks_placed(source):
    problem, _ = built(*SIZES, f"deployment={source}", "deployment.count=[4,2]")
    assert sorted(problem.edges) == [0.06] * 4 + [0.20] * 2
    assert derived(problem) == {"deployment.count": 6, "tag.counts": [4, 2]}  # as recorded


def test_fixed_landmarks_come_on_top():
    problem, _ = built(*SIZES, "deployment.fixed=tags.csv", "deployment.count=[4,2]")
    assert (problem.fixed_count, problem.count) == (2, 8)
    np.testing.assert_array_equal(problem.sizes, [0.1, 0.1, 0.06, 0.06, 0.06, 0.06, 0.20, 0.20])


@pytest.mark.parametrize(
    ("limit", "low", "high"), [(["tag.paper=0.1"], 0.1 - 0.075**2, 0.1), (["tag.costs=[1,4]", "tag.budget=12"], 11, 12)]
)
def test_paper_or_costs_say_how_many_there_are(limit, low, high, capsys):
    problem, _ = built(*SIZES, *limit)
    counts = np.array(problem.scene.tag.counts)
    assert counts.sum() == problem.count
    papers = problem.scene.footprints.papers(problem.draw(np.random.default_rng(0))) ** 2
    assert low < (papers.sum() if len(limit) == 1 else counts @ (1, 4)) <= high
    assert (
        f"{limit[-1].replace('=', ' = ')}{' square metres' if len(limit) == 1 else ''} make" in capsys.readouterr().err
    )


@pytest.mark.parametrize("name", ["ega", "sga", "pymoo_ga", "nevergrad", "cma_es"])
def test_black_boxes_place_what_the_paper_suffices_for(name):
    problem, cfg = built(*SIZES, "tag.paper=0.1", f"optimiser={name}", "objective.thold_p=0.1")
    result = build_optimiser(cfg, 0).run(problem, Budget(40))
    assert result.fitness == problem.fitness_of(result.deployment)
    tag = problem.scene.tag
    assert [int((result.deployment.edges == edge).sum()) for edge in tag.sizes] == list(tag.counts)
    problem.scene.footprints.check(result.deployment)


SIGHT = pytest.mark.thorough("pipelines", "lmd/scene", "lmd/sight")  # kernels of one more kind of sight


@SIGHT
def test_a_run_with_sizes_is_evaluated_as_it_was_found(tmp_path):
    settings = ("room.spacing=1.5", "visibility=fiducial", *SIZES, "tracking=none", "validate=false")
    inside("optimise", "optimiser=random_search", "budget.evaluations=20", "deployment.count=[12,6]", *settings,
         "hydra.run.dir=run", cwd=tmp_path)  # fmt: skip
    landmarks = pd.read_csv("run/landmarks.csv")
    assert landmarks.edge.tolist() == [0.06] * 12 + [0.20] * 6
    inside("evaluate", "run=run", "tracking=none", "localisation=false", "hydra.run.dir=again", cwd=tmp_path)
    found, again = (json.load(open(f"{run}/metrics.json")) for run in ("run", "again"))  # noqa: SIM115
    assert again["fitness"] == found["fitness"] > 0.0


FRC = ("room=floor_plan", "room.path=${lmd.conf:experiment/2025-reefscape-welded.json}", "room.height=3",
       "camera=ov9281", "pdf=yaw", "tag.edge=0.1", "visibility=fiducial", "objective=localisation")  # fmt: skip


@SIGHT  # two scenes with obstacles or many positions: some 15 s each
@pytest.mark.parametrize(
    "scene",
    [
        ("experiment=hall", "tag.edges=[0.15,0.30]", "room.spacing=4", "deployment.count=[60,10]"),
        (*FRC, "tag.edges=[0.1651,0.25]", "room.spacing=1", "tag.paper=0.5"),
    ],
)
def test_sizes_are_mixed_in_a_hall_and_on_a_field(scene, tmp_path):
    quick = ("optimiser=random_search", "budget.evaluations=3", "tracking=none", "validate=false", "picture=false")
    run = inside("optimise", *scene, *quick, "hydra.run.dir=run", cwd=tmp_path, settings=())
    assert run.returncode == 0, run.stderr
    tag = json.loads((tmp_path / "run" / "metrics.json").read_text())["settings"]["tag"]
    edges = pd.read_csv(tmp_path / "run" / "landmarks.csv").edge
    assert [(edges == edge).sum() for edge in tag["edges"]] == tag["counts"]
