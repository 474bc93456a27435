"""`import lmd` is enough: what it exports, its example, and the one of the page "From Python"."""

import doctest
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from support.processes import environment
from support.rooms import L_SHAPE, written
from support.small import problem

import lmd
from lmd.optimisers.genetic import EGA
from lmd.space.floor_plan import FloorPlan

FROM_PYTHON = (Path(__file__).parents[1] / "docs" / "api" / "index.md").read_text(encoding="utf-8")


def test_every_exported_name_is_there():
    assert set(lmd.__all__) <= set(dir(lmd))
    assert all(getattr(lmd, name) is not None for name in lmd.__all__)
    with pytest.raises(AttributeError, match=r"module 'lmd' has no attribute 'Sphere'"):
        _ = lmd.Sphere


def test_the_example_in_the_documentation_is_right():
    assert doctest.testmod(lmd).failed == 0


def test_importing_it_loads_neither_the_compiler_nor_a_library_that_only_some_need():
    heavy = {"numba", "hydra", "mlflow", "matplotlib", "pymoo", "nevergrad", "cma", "cv2", "scipy"}
    code = f"import sys, lmd; loaded = {heavy} & set(sys.modules); assert not loaded, loaded"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_default_is_annealing_and_any_optimiser_can_take_its_place():
    p = problem()
    default, other = lmd.optimise(p, evaluations=100, seed=1), lmd.optimise(p, evaluations=100, optimiser=EGA(seed=1))
    again = lmd.Annealing(seed=1).run(p, lmd.Budget(100))
    assert (default.deployment.positions == again.deployment.positions).all()
    assert default.fitness > other.fitness


def test_a_callback_stops_it_and_no_limit_is_refused():
    assert lmd.optimise(problem(), evaluations=1000, callback=lambda _: True).stopped == "interrupted"
    with pytest.raises(lmd.InputError, match="evaluations or seconds must be given"):
        lmd.optimise(problem())


def test_any_deployment_in_the_room_is_scored_and_one_outside_is_not():
    p = problem()
    deployment = p.start.draw(p.scene.room, np.random.default_rng(0))
    figures = lmd.evaluate(p, deployment, validate=True)
    assert figures["fitness"] == p.fitness_of(deployment)
    assert "grid_free_qualified_ratio" in figures
    with pytest.raises(lmd.InputError, match=r"landmark 0 at \(9, 1, 1\) lies outside the room of 7\.5 x 5 x 6 m"):
        lmd.evaluate(p, lmd.Deployment([[9.0, 1.0, 1.0]] * 2, [[1.0, 0.0, 0.0]] * 2))
    with pytest.raises(lmd.InputError, match=r"n = 2 exceeds the number of landmarks, 1"):
        lmd.evaluate(p, deployment[:1])


def test_the_example_of_a_mesh_lists_its_surfaces(tmp_path, monkeypatch, capsys):
    page = (Path(__file__).parents[1] / "docs" / "rooms.md").read_text(encoding="utf-8")
    (code,) = (code for code in re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL) if "lmd.Scan(" in code)
    written(tmp_path / "lab.glb", FloorPlan(L_SHAPE, 2.5))
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    assert capsys.readouterr().out.count(" m2") > 5


@pytest.mark.slow
def test_the_example_of_the_page_runs_with_a_small_budget(tmp_path):
    (code,) = re.findall(r"```python\n(.*?)```", FROM_PYTHON, flags=re.DOTALL)
    code = code.replace("evaluations=3000", "evaluations=60")
    line = [sys.executable, "-c", code]
    done = subprocess.run(line, cwd=tmp_path, env=environment(), check=True, capture_output=True, text=True)
    assert "'grid_free_qualified_ratio'" in done.stdout
    assert len(pd.read_csv(tmp_path / "landmarks.csv")) == 90
    assert (tmp_path / "scene.png").stat().st_size > 30_000
