"""The commands and programs of docs/recipes and docs/nav2.md, as a reader copies them, with small budgets."""

import json
import math
import re
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import shapely
import yaml
from support.processes import inside
from support.rooms import OCCUPIED, box, hall, write_map

from lmd.formats.tag_maps import read_deployment

FOLDER = Path(__file__).parents[2] / "docs" / "recipes"
FILES = [*sorted(FOLDER.glob("*.md")), FOLDER.parent / "nav2.md"]
PAGES = {path.stem: path.read_text(encoding="utf-8") for path in FILES}
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
        more, overrides = small.get(name, SMALL[name]), [word.replace("RUN", "optimise") for word in overrides]
        keys = {each.partition("=")[0] for each in more}
        kept = [each for each in overrides if each.partition("=")[0] not in keys]
        done = inside(name, *kept, *more, "tracking=none", cwd=cwd, settings=())
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("page", PAGES)
def test_a_page_is_short(page):
    words = re.sub(r"```.*?```|\|.*\|", "", PAGES[page], flags=re.S).split()
    assert len(words) <= (350 if page == "nav2" else 300)


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


@pytest.mark.thorough("docs/nav2.md", *RUNS[1:], "lmd/export")  # three quarters of a minute, most of it compiling
def test_the_map_of_a_robot_leads_to_tags_in_its_frame(tmp_path, monkeypatch):
    origin, yaw = np.array([-12.5, 3.75]), 0.3
    grey = hall()
    box(grey, 2.0, 1.0, 2.6, 1.6, OCCUPIED)
    write_map(tmp_path, grey, origin=[*origin.tolist(), yaw])
    matrix = {"data": [553.8, 0.0, 321.4, 0.0, 554.1, 238.7, 0.0, 0.0, 1.0]}
    lens = {"distortion_model": "plumb_bob", "distortion_coefficients": {"data": [-0.05, 0.02, 0.0, 0.0, 0.0]}}
    calibration = {"image_width": 640, "image_height": 480, "camera_matrix": matrix, **lens}
    (tmp_path / "camera_info.yaml").write_text(yaml.safe_dump(calibration))
    quick = ["deployment.count=6", "room.spacing=2", "validate=false"]
    found = {name: [*quick, f"hydra.run.dir=outputs/{name}"] for name in ("evaluate", "optimise")}
    found["optimise"].append("budget.evaluations=2")
    follow("nav2", monkeypatch, tmp_path, **found, export=["hydra.run.dir=outputs/export"])
    for name in ("evaluate", "optimise"):
        assert (tmp_path / "outputs" / name / "room.png").stat().st_size > 5000
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    corners = np.array([[0, 0], [6, 0], [6, 4], [0, 4]]), np.array([[2, 1], [2.6, 1], [2.6, 1.6], [2, 1.6]])
    walls = shapely.MultiLineString([shapely.Polygon((at + 0.5) @ turn.T + origin).boundary for at in corners])
    planned = read_deployment(str(tmp_path / "outputs" / "optimise" / "landmarks.csv"))
    exported = read_deployment(str(tmp_path / "outputs" / "export" / "tags.ros2_tf.launch.py"))
    for deployment in (planned, exported):
        assert len(deployment) == 6
        assert shapely.distance(walls, shapely.points(deployment.positions[:, :2])).max() < 1e-3
        np.testing.assert_allclose(deployment.positions, planned.positions, atol=1e-3)
    assert {"plan.pdf", "sheets.pdf"} < {path.name for path in (tmp_path / "outputs" / "export").iterdir()}
