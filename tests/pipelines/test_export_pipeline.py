"""`pipelines.export` as a user meets it: a process, its messages, its exit code and the files it leaves."""

import json

import pytest
from support.processes import SMALL, inside

LANDMARKS = "id,x,y,z,nx,ny,nz,note\n7,0,2,3,1,0,0,by the door\n3,0,3,3,1,0,0,\n9,7.5,2,3,-1,0,0,\n"
TAGS = (*SMALL, "tag.edge=0.15")
pytestmark = pytest.mark.slow


@pytest.fixture
def work(tmp_path):
    (tmp_path / "mine.csv").write_text(LANDMARKS)
    return tmp_path


def ids(path):
    return {tag["ID"] for tag in json.loads(path.read_text())["tags"]}


def test_a_run_writes_its_own_maps_and_can_be_exported_later(work):
    overrides = ("deployment.count=6", "objective.n=1", "budget.evaluations=2", "tracking=none", "hydra.run.dir=found")
    done = inside("optimise", *overrides, "export=[wpilib,csv,plan]", cwd=work, settings=TAGS)
    assert done.returncode == 0, done.stderr
    assert {"tags.wpilib.json", "tags.csv", "plan.pdf"} < {path.name for path in (work / "found").iterdir()}
    assert not (work / "found" / "sheets.pdf").exists()
    done = inside("export", "run=found", "formats=[wpilib]", "hydra.run.dir=out", cwd=work, settings=())
    assert done.returncode == 0, done.stderr
    layouts = [work / folder / "tags.wpilib.json" for folder in ("found", "out")]
    assert layouts[0].read_bytes() == layouts[1].read_bytes()
    assert ids(layouts[0]) == set(range(6))


def test_a_map_of_one_stack_becomes_that_of_another(work):
    (work / "map.txt").write_text("# Clover\n3 0.15 0 2 3 1.5707963267948966 0 1.5707963267948966\n9 0.05 1 2 0\n")
    found = "deployment.path=map.txt", "deployment.columns=clover", "tag.family=4x4_50"
    done = inside(
        "export", *found, "formats=[aruco,json]", "tracking=none", "hydra.run.dir=out", cwd=work, settings=TAGS
    )
    assert done.returncode == 0, done.stderr
    assert "note: tag.edge = 0.15 m (black square) holds for 1 of 2 tags; the others have" in done.stderr
    tags = json.loads((work / "out" / "tags.json").read_text())["tags"]
    assert [(tag["id"], tag["edge"]) for tag in tags] == [(3, 0.15), (9, 0.05)]
    assert tags[0]["corners"]["top_left"] == pytest.approx([0.0, 1.925, 3.075])
    done = inside("export", *found, "formats=[rtabmap]", cwd=work, settings=TAGS)
    assert done.returncode == 1
    assert "formats has rtabmap: it holds one edge length, but the tags have 0.05, 0.15 m" in done.stderr
