"""`deployment.fixed` and `deployment.count=+5` on the command line."""

import json

import numpy as np
import pandas as pd
import pytest
from support.composing import composed
from support.processes import inside

from lmd.core.checks import InputError
from pipelines.building import build_problem

TAGS = "id,x,y,z,nx,ny,nz,note\n7,0,2,3,1,0,0,door\n3,0.02,3,3,1,0,0,\n"
QUICK = ("tracking=none", "localisation=false")


@pytest.fixture
def work(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tags.csv").write_text(TAGS)
    return tmp_path


def built(*overrides):
    cfg = composed("optimise", "room.spacing=1.5", "deployment.fixed=tags.csv", *overrides)
    return build_problem(cfg)


@pytest.mark.usefixtures("work")
@pytest.mark.parametrize("source", ["random", "uniform", "greedy"])
@pytest.mark.parametrize(("count", "free"), [("6", 4), ("+6", 6)])
def test_a_count_is_that_of_all_and_one_with_a_plus_that_of_the_new(source, count, free):
    problem = built(f"deployment={source}", f"deployment.count={count}")
    assert (problem.fixed_count, problem.free_count, problem.count) == (2, free, 2 + free)
    assert problem.draw(np.random.default_rng(0)).ids.tolist() == [7, 3, *[0, 1, 2, 4, 5, 6][:free]]


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["deployment.fixed=null", "deployment.count=+5"], r"^deployment.count = \+5 needs deployment.fixed"),
        (["deployment.count=2"], r"^deployment.count = 2 leaves no landmark to place: tags.csv has 2"),
        (["deployment.count=+0"], r"^deployment.count = \+0 leaves no landmark to place"),
        (["deployment.count=some"], r"^deployment.count must be a whole number"),
        (["deployment.fixed=none.csv"], r"none.csv"),
        (["deployment.fixed=3"], r"^deployment.fixed must be the path of a file"),
        (["room.size=[7.5,2.5,6]", "room.reachable_size=[6,2,4]"], r"^deployment.fixed: landmark 3 at .* lies outside"),
        (["deployment=file", "deployment.path=tags.csv"], r"^deployment.fixed has all 2 landmarks"),
        (["deployment=file", "deployment.path=new.csv", "deployment.count=9"], r"^deployment.count = 9, but there are"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_in_a_sentence(work, overrides, message):
    (work / "new.csv").write_text(TAGS + "8,0,4,3,1,0,0,\n")
    with pytest.raises(InputError, match=message):
        built(*overrides)


@pytest.mark.slow
def test_tags_are_added_to_what_hangs_already(work):
    seen = ("objective.thold_p=0.02", "objective.n=1")
    more = ("deployment.fixed=tags.csv", "deployment.count=+5", "budget.evaluations=60", "hydra.run.dir=run", *seen)
    done = inside("optimise", *more, *QUICK[:1], cwd=work)
    assert done.returncode == 0, done.stderr
    landmarks = pd.read_csv(work / "run" / "landmarks.csv")
    assert landmarks.fixed.tolist() == [1, 1, 0, 0, 0, 0, 0]
    hangs = pd.read_csv(work / "tags.csv")
    pd.testing.assert_frame_equal(landmarks[list(hangs)][:2], hangs, check_dtype=False)
    found = json.loads((work / "run" / "metrics.json").read_text())
    assert found["settings"]["fixed_landmarks"] == 2
    (work / "tags.csv").unlink()  # what a run was about is in its own folder
    again = inside(
        "evaluate", "run=run", "hydra.run.dir=again", *QUICK, cwd=work, settings=("validate=false", "picture=false")
    )
    assert again.returncode == 0, again.stderr
    scored = json.loads((work / "again" / "metrics.json").read_text())
    losses = pd.read_csv(work / "again" / "losses.csv")
    assert scored["fitness_without_one_worst"] == pytest.approx(losses.fitness_without.min())
    assert "fitness without two, mean" in again.stdout
    assert f"fitness lost without each: {losses.id[0]} ({100.0 * losses.fitness_loss[0]:.2f})" in again.stdout
    assert scored["fitness"] == found["fitness"]
    assert scored["settings"]["fixed_landmarks"] == 2
