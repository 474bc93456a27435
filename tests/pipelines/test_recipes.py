"""The commands and programs of docs/recipes, as a reader copies them, with small budgets."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from support.processes import inside
from support.rooms import OCCUPIED, box, hall, write_map

FOLDER = Path(__file__).parents[2] / "docs" / "recipes"
PAGES = {path.stem: path.read_text(encoding="utf-8") for path in sorted(FOLDER.glob("*.md"))}
BLOCK = re.compile(r"```(sh|python)\n(.*?)```", re.S)
SMALL = {
    "optimise": ["budget.evaluations=3", "validate=false", "picture=false"],
    "evaluate": ["validate=false", "picture=false", "localisation=false"],
    "tradeoff": ["counts=[12,24]", "wanted=null", "budget.evaluations=1", "seeds=1", "workers=1"],
    "export": ["formats=[csv]"],
}
RUNS = "docs/recipes", "pipelines", "lmd/formats", "lmd/space"

pytestmark = pytest.mark.slow


def follow(page, monkeypatch, cwd, **small):
    """Run the blocks of a page one after the other."""
    monkeypatch.chdir(cwd)
    for kind, text in BLOCK.findall(PAGES[page]):
        if kind == "python":
            exec(compile(text, f"{page}.md", "exec"), {})
            continue
        _, _, module, *overrides = shlex.split(text.replace("\\\n", ""))
        name = module.removeprefix("pipelines.")
        more = small.get(name, SMALL[name])
        keys = {each.partition("=")[0] for each in more}
        kept = [each for each in overrides if each.partition("=")[0] not in keys]
        done = inside(name, *kept, *more, "tracking=none", cwd=cwd, settings=())
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("page", PAGES)
def test_a_recipe_has_at_most_300_words(page):
    assert len(re.sub(r"```.*?```", "", PAGES[page], flags=re.S).split()) <= 300


@pytest.mark.thorough(*RUNS)  # each half a minute where nothing is compiled
def test_tags_at_two_depths_guide_a_robot_to_its_dock(tmp_path, monkeypatch):
    follow("docking", monkeypatch, tmp_path, optimise=["validate=false", "picture=false"])
    flat, step = (
        json.loads((tmp_path / "outputs" / name / "metrics.json").read_text())["fitness"] for name in ("flat", "step")
    )
    assert step > flat + 0.1 > 0.8


@pytest.mark.thorough(*RUNS)
def test_tags_on_the_floor_serve_a_camera_that_looks_down(tmp_path, monkeypatch):
    follow("drone", monkeypatch, tmp_path)
    assert (pd.read_csv(tmp_path / "outputs" / "drone" / "landmarks.csv").z == 0.0).all()


@pytest.mark.thorough(*RUNS)
def test_tags_hang_in_the_aisles_of_a_warehouse(tmp_path, monkeypatch):
    grey = hall(10.0, 6.0)
    for low in (1.5, 3.5):
        box(grey, 1.5, low, 8.5, low + 1.0, OCCUPIED)
    write_map(tmp_path, grey)
    at = np.linspace(1.0, 9.0, 40)
    rows = [f"{10 * k},{x},3.0,1.0,0,0,0" for k, x in enumerate(at)]
    (tmp_path / "drive.csv").write_text("time,x,y,z,roll,pitch,yaw\n" + "\n".join(rows))
    follow("warehouse", monkeypatch, tmp_path)
    tags = pd.read_csv(tmp_path / "outputs" / "aisles" / "landmarks.csv")
    assert tags.z.between(0.3, 0.6).all()


@pytest.mark.thorough("docs/recipes", "pipelines/evaluate.py", "lmd/evaluation/losses.py", "lmd/objectives/without.py")
def test_the_tags_that_may_go_are_named(tmp_path, monkeypatch):
    inside("optimise", "experiment=lab", "deployment.count=20", *SMALL["optimise"], "tracking=none",
           "hydra.run.dir=first", cwd=tmp_path, settings=())  # fmt: skip
    (tmp_path / "tags.csv").write_bytes((tmp_path / "first" / "landmarks.csv").read_bytes())
    follow("fewer_tags", monkeypatch, tmp_path)
    twenty, fifteen, moved = (
        json.loads((tmp_path / "outputs" / name / "metrics.json").read_text())
        for name in ("twenty", "fifteen", "moved")
    )
    losses = pd.read_csv(tmp_path / "outputs" / "twenty" / "losses.csv").set_index("removed")
    assert fifteen["fitness"] == pytest.approx(losses.fitness_left[5], abs=1e-12)
    assert len(pd.read_csv(tmp_path / "outputs" / "moved" / "landmarks.csv")) == 20
    assert 0.0 < fifteen["fitness"] <= moved["fitness"]
    assert twenty["fitness"] > 0.0
