"""Kernels as plain Python, for a debugger or for coverage: `NUMBA_DISABLE_JIT=1`."""

import json
import subprocess
import sys
from dataclasses import replace

import pytest
from support.paper import paper_camera, paper_room, paper_scene
from support.processes import ROOT, call, environment
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
WHOLE = ("budget.evaluations=3", "room.spacing=2", "validate=false", "picture=false", "tracking=none")


def found_by_walking(name):
    room, camera, objective = CASES[name]
    scene = paper_scene(room, camera, pdf.grid_with_ends(2), thold=0.1, nu=0.3, occlusion="line_of_sight")
    problem = Problem(replace(scene, tag=Tag(0.2)), objective, RandomDeployment(8), threads=1)
    found = lmd.optimise(problem, evaluations=4, optimiser=Annealing(walkers=1))
    return [found.fitness, found.deployment.positions.tolist(), found.deployment.normals.tolist()]


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.thorough("lmd/core", "lmd/incremental", "lmd/objectives", "lmd/sight"))
        if name != "localisation"
        else name
        for name in CASES
    ],
)
def test_walks_in_plain_python_end_at_the_same_bits(name, tmp_path):
    """30 s of processor time together, once their kernels are compiled."""
    code = f"import json, test_disabled_compiler as t; print(json.dumps(t.found_by_walking({name!r})))"
    environ = environment(ROOT / "tests") | {"NUMBA_DISABLE_JIT": "1"}
    line = [sys.executable, "-c", code]
    done = subprocess.run(line, cwd=tmp_path, env=environ, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr
    assert json.loads(done.stdout) == found_by_walking(name)


def found_by_a_run(folder):
    """All that a run says of what it found; without the time that it took."""
    folder.mkdir()
    done = call("optimise", "hydra.run.dir=run", cwd=folder, settings=WHOLE, fresh=True)
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr
    run = folder / "run"
    metrics = json.loads((run / "metrics.json").read_text())
    del metrics["wall_time"]
    history = [line.rpartition(",")[0] for line in (run / "history.csv").read_text().splitlines()]
    return (run / "landmarks.csv").read_bytes(), metrics, history


@pytest.mark.slow
@pytest.mark.thorough("lmd/core/compiled.py", "lmd/optimisers/annealing", "pipelines/optimise.py")
def test_a_run_in_plain_python_has_the_same_figures(tmp_path, monkeypatch):
    """10 s of processor time: the walk of 90 landmarks in the paper's room, not compiled."""
    compiled = found_by_a_run(tmp_path / "compiled")
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    assert found_by_a_run(tmp_path / "python") == compiled
