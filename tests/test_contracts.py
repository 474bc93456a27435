"""Contracts of the parts of the library; those of optimisers and formats are beside their other tests."""

from pathlib import Path

import numpy as np
import pytest
from contracts.criterion import check_alone, check_criterion
from contracts.estimator import check_estimator
from contracts.objective import check_objective
from contracts.space import check_space
from support.composing import composed
from support.paper import experiment_room, paper_camera
from support.rooms import L_SHAPE, PILLAR, RACK, lab, mesh_room

from lmd.scene.tag import Tag
from lmd.sight.models.fiducial import Fiducial
from lmd.sight.models.paper import Visibility
from lmd.space.floor_plan import FloorPlan
from pipelines.app import CONF
from pipelines.building import build_problem
from pipelines.nodes import instantiate

pytestmark = pytest.mark.long

BENT = paper_camera(distortion=(-0.15, 0.02, 0.002, -0.003))
CRITERIA = {
    "paper": (Visibility(thold=0.1), paper_camera()),
    "line_of_sight": (Visibility(thold=0.1, occlusion="line_of_sight"), paper_camera()),
    "distorted": (Fiducial(Tag(0.2)), BENT),
    "tags": (Fiducial(Tag(0.2)), paper_camera()),
}
L = FloorPlan(L_SHAPE, 2.5, holes=[PILLAR], obstacles=[RACK])


def options(group):
    return sorted(path.stem for path in Path(CONF, group).glob("*.yaml"))


@pytest.mark.parametrize("name", ["paper", "line_of_sight", "tags"])
def test_every_criterion_keeps_its_contract_for_one_camera(name):
    check_alone(*CRITERIA[name], np.random.default_rng(0))


@pytest.mark.thorough("lmd/incremental", "lmd/scene/criteria.py", "lmd/sight", "tests/contracts")
@pytest.mark.parametrize(("criteria", "camera"), CRITERIA.values(), ids=CRITERIA)
def test_every_criterion_keeps_its_contract(criteria, camera):
    check_criterion(criteria, camera)


FILTERED = pytest.mark.thorough("lmd/objectives/filtered", "lmd/incremental")  # compiled for it alone


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=FILTERED if name == "filtered" else ()) for name in options("objective")]
)
def test_every_objective_keeps_its_contract(name):
    cfg = composed("optimise", f"objective={name}", "tag.edge=0.3", "room.spacing=2", "pdf.divisions=6", "threads=1")
    problem = build_problem(cfg)
    check_objective(problem.objective, problem.scene)


@pytest.mark.parametrize("room", [experiment_room(spacing=0.8), lab(spacing=1.0)], ids=["cuboid", "floor_plan"])
def test_every_space_keeps_its_contract(room):
    check_space(room)


def test_a_mesh_keeps_the_contract_of_a_space_for_what_stays(tmp_path):
    check_space(mesh_room(tmp_path / "lab.glb", L, spacing=1.0), moves=False)


@pytest.mark.thorough("lmd/incremental", "lmd/sight", "lmd/space", "tests/contracts")
def test_a_mesh_keeps_the_contract_of_a_space(tmp_path):
    """Moves among triangles, which take 8 s to compile."""
    check_space(mesh_room(tmp_path / "lab.glb", L, spacing=1.0))


@pytest.mark.parametrize("name", options("estimator"))
def test_every_estimator_keeps_its_contract(name):
    (estimator,) = composed("evaluate", "studies=observe", f"estimator=[{name}]").estimator.values()
    check_estimator(instantiate(estimator))
