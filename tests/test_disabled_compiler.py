"""Kernels as plain Python, for a debugger or for coverage: `NUMBA_DISABLE_JIT=1`."""

import json
import subprocess
import sys
from dataclasses import replace

import pytest
from support.paper import paper_camera, paper_room, paper_scene
from support.processes import ROOT, environment
from support.rooms import lab

import lmd
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.optimisers.annealing import Annealing
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.rig import Mount, Rig
from lmd.scene.tag import Tag

RIG = Rig((Mount(paper_camera(), (0.0, 0.1, 0.3)), Mount(paper_camera(focal_length=8.0), yaw=2.0)))
ROOM = paper_room(spacing=2.5)
COVERAGE, LOCALISATION = Coverage(2, 0.1), Localisation(n=2, tolerance=0.3)
CASES = {
    "camera": (ROOM, paper_camera(), COVERAGE),
    "rig": (ROOM, RIG, COVERAGE),
    "localisation": (ROOM, paper_camera(), LOCALISATION),
    "localisation of a rig": (ROOM, RIG, LOCALISATION),
    "among obstacles": (lab(spacing=2.0), paper_camera(), COVERAGE),
}


OTHERS = pytest.mark.thorough("lmd/core", "lmd/incremental", "lmd/objectives", "lmd/sight")


def found_by_walking(name):
    room, camera, objective = CASES[name]
    scene = paper_scene(room, camera, pdf.grid_with_ends(2), thold=0.1, nu=0.3, occlusion="line_of_sight")
    problem = Problem(replace(scene, tag=Tag(0.2)), objective, RandomDeployment(8), threads=1)
    found = lmd.optimise(problem, evaluations=4, optimiser=Annealing(walkers=1))
    return [found.fitness, found.deployment.positions.tolist(), found.deployment.normals.tolist()]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["camera", *(pytest.param(name, marks=OTHERS) for name in CASES if name != "camera")])
def test_walks_in_plain_python_end_at_the_same_bits(name, tmp_path):
    """30 s of processor time together, once their kernels are compiled."""
    code = f"import json, test_disabled_compiler as t; print(json.dumps(t.found_by_walking({name!r})))"
    environ = environment(ROOT / "tests") | {"NUMBA_DISABLE_JIT": "1"}
    line = [sys.executable, "-c", code]
    done = subprocess.run(line, cwd=tmp_path, env=environ, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr
    assert json.loads(done.stdout) == found_by_walking(name)
