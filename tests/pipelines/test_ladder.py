"""The points of `pipelines.tradeoff`: their figures, and what is kept of them."""

import numpy as np
import pytest
from support.composing import composed

from lmd.core.checks import InputError
from lmd.evaluation.tradeoff import ANEW, Found
from lmd.evaluation.validation import Sample, headline_off_grid
from pipelines import points

SMALL = ("room.spacing=1.5", "objective.n=1")
YAW = ("pdf=yaw", "pdf.divisions=4")
RECORDED = "time,x,y,z,yaw,pitch\n" + "".join(f"{t},2,2,2,{0.1 * t},0\n" for t in range(60))


def ladder_of(*overrides, edge=0.0):
    return points.Ladder(composed("tradeoff", *SMALL, *overrides), edge, 0)


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr("lmd.evaluation.tradeoff.SAMPLE", Sample(2, 4, 2))


@pytest.fixture
def drive(tmp_path):
    """Overrides for recorded poses."""
    path = tmp_path / "drive.csv"
    path.write_text(RECORDED)
    return "poses=recorded", f"poses.path={path}"


def figures_of(problem):
    return points.figures_of(problem, problem.draw(np.random.default_rng(0)), 0)


@pytest.mark.usefixtures("quick")
def test_a_single_camera_has_figures_of_single_images():
    problem = ladder_of(*YAW).problem(6)
    figures = figures_of(problem)
    assert {"covered_share", "localised_share_20mm", headline_off_grid(problem)} <= set(figures)


@pytest.mark.parametrize(("held_out", "headline"), [(5, "held_out_share"), ("null", "recorded_share")])
def test_recorded_poses_are_judged_by_what_was_held_out(drive, held_out, headline):
    problem = ladder_of(*drive, f"poses.held_out={held_out}").problem(6)
    assert headline_off_grid(problem) == headline
    assert headline in points.shares_among(figures_of(problem))


def test_what_other_code_has_computed_is_not_taken(tmp_path, monkeypatch):
    known = ladder_of(*YAW, f"kept={tmp_path}")
    found = Found(known.problem(6).draw(np.random.default_rng(0)), 0.0, ANEW)
    scored = []
    monkeypatch.setattr(points, "figures_of", lambda *_: scored.append(0) or {"share": len(scored)})
    assert [known.figures(6, found)["share"] for _ in range(2)] == [1, 1]
    monkeypatch.setattr("lmd.core.sources.package_digest", lambda: "other code")
    assert known.figures(6, found)["share"] == 2


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("damage", ["", "{", "[1]", "{}", "\0\0", '{"positions": 5, "normals": 5, "surfaces": 5}'])
def test_what_is_kept_but_damaged_is_named_and_computed_again(damage, tmp_path, capsys):
    known = ladder_of(*YAW, f"kept={tmp_path}", "optimiser=random_search", "budget.evaluations=2")
    found = known.anew(6)
    (path,) = tmp_path.iterdir()
    whole = path.read_text()
    path.write_text(damage)
    assert known.anew(6).fitness == found.fitness
    assert f"warning: {path} is damaged (" in capsys.readouterr().err
    assert (path.read_text(), path.with_name(f"{path.name}.damaged").read_text()) == (whole, damage)


def test_too_many_landmarks_are_named_by_the_key_that_asked_for_them(tmp_path):
    (tmp_path / "tags.csv").write_text("id,x,y,z,nx,ny,nz\n0,0,2,3,1,0,0\n1,0,3,3,1,0,0\n")
    with pytest.raises(InputError, match=r"^counts = 2 leaves no landmark to place"):
        ladder_of(f"deployment.fixed={tmp_path}/tags.csv").problem(2)
    with pytest.raises(InputError, match=r"^counts = 20 tags .* are too many"):
        ladder_of(edge=2.0).problem(20)


def test_shares_are_fractions_of_which_more_is_better():
    shares = ["qualified_ratio", "fitness", "grid_free_qualified_ratio", "held_out_share", "covered_share"]
    others = ["cost", "held_out_seconds", "grid_free_qualified_ratio_standard_error", "predicted_error_90"]
    assert points.shares_among([*others, *shares]) == shares
