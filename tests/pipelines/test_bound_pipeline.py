"""`pipelines.bound`, as a user meets it."""

import json

import pytest
from processes import inside

from lmd.evaluation.selection_bound import GUARANTEE

SMALL_BOUND = ["room.spacing=2.0", "pdf.divisions=6", "bound.spacing=1.0", "bound.iterations=40", "tracking=none"]


@pytest.mark.slow
def test_the_command_prints_and_writes_the_bounds(tmp_path):
    done = inside(
        "bound",
        *SMALL_BOUND,
        "deployment.count=12",
        "bound.target=0.5",
        "bound.seconds=null",
        "hydra.run.dir=run",
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    document = json.loads((tmp_path / "run" / "bound.json").read_text())
    assert f"<= {document['average_coverage_probability']['walls']:.2%} for any 12 landmarks" in done.stdout
    assert f">= {document['target']['fewest_landmarks']} for a fitness of 50.00%" in done.stdout
    assert document["settings"]["landmarks"] == 12
    assert set(document["fitness"]) == {"walls", "grid", "fractional"}
    assert f">= {document['selection']['share']:.2%} of the best 12 poses of the grid" in done.stdout


@pytest.mark.slow
def test_the_command_bounds_what_localises(tmp_path):
    settings = [*SMALL_BOUND, "objective=localisation", "tag.edge=0.2", "deployment.count=12", "hydra.run.dir=run"]
    done = inside("bound", cwd=tmp_path, settings=settings)
    assert done.returncode == 0, done.stderr
    document = json.loads((tmp_path / "run" / "bound.json").read_text())
    assert 0.0 < document["selection"]["greedy"] <= document["selection"]["grid"]
    assert GUARANTEE < document["selection"]["share"] <= 1.0
    assert (
        f">= {document['selection']['share']:.2%} of the best 12 poses of the grid, by the mean log det" in done.stdout
    )
    assert document["settings"]["objective"] == "Localisation"
    assert 0.0 < document["fitness"]["grid"] <= document["fitness"]["walls"] < 1.0
