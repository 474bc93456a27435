"""Tags on printed sheets, of which a survey is told; some 5 seconds in all."""

from dataclasses import replace

import numpy as np
import pytest
import walks

from lmd.core.checks import InputError
from lmd.geometry.se3 import exp, log
from lmd.scene.tag import Tag
from lmd.survey.boards import Boards
from lmd.survey.prior import Known
from lmd.survey.survey import survey

SHEETS, EACH, APART, SIGMA, PRINTED = 8, 4, 0.13, 0.3, 0.0002
CORNERS = APART / 2.0 * np.array([[-1, 1], [1, 1], [-1, -1], [1, -1]])
IDS = np.arange(SHEETS * EACH)
BOARDS = Boards(tuple(str(k // EACH) for k in IDS), IDS, np.tile(CORNERS, (SHEETS, 1)), PRINTED)


@pytest.fixture(scope="module")
def room():
    """Sheets with errors of printing on four walls, and few photographs of them."""
    rng = np.random.default_rng(6)
    sheets = walks.spaced_tags(SHEETS, rng)
    offset = np.zeros((SHEETS * EACH, 6))
    offset[:, 3:5] = np.tile(CORNERS, (SHEETS, 1)) + rng.normal(0.0, PRINTED, (SHEETS * EACH, 2))
    true = np.repeat(sheets, EACH, axis=0) @ exp(offset)
    return true, walks.photographed(true, walks.walk(40, rng), rng, SIGMA)


def surveyed(detected, boards):
    return survey(detected, [walks.CAMERA], Tag(walks.EDGE), walks.constant_errors(SIGMA), Known(boards=boards))


def spacing(found, true):
    """How far the tags of a sheet are off beside its first one, metres, median."""
    places = found.found.poses.tags[:, :3, 3].reshape(SHEETS, EACH, 3)
    own = true[:, :3, 3].reshape(SHEETS, EACH, 3)
    return np.median(
        np.abs(np.linalg.norm(places[:, 1:] - places[:, :1], axis=2) - np.linalg.norm(own[:, 1:] - own[:, :1], axis=2))
    )


def test_a_map_is_better_known_where_sheets_are(room):
    true, detected = room
    told, alone = surveyed(detected, BOARDS), surveyed(detected, None)
    assert spacing(told, true) < 0.7 * spacing(alone, true)
    assert np.median(told.found.sigmas) < np.median(alone.found.sigmas)


def test_a_tag_that_is_not_where_the_sheet_says_does_no_harm(room):
    true, detected = room
    places = BOARDS.places.copy()
    places[5] += 0.05
    found = surveyed(detected, replace(BOARDS, places=places))
    assert found.placed.all()
    assert spacing(found, true) < 0.001


def test_what_sheets_say_is_the_slope_and_the_curvature_of_what_they_cost(room):
    """By differences of the cost: of a sheet that lies as well as it can, whatever the tags' own poses are."""
    true, _ = room
    rng = np.random.default_rng(1)
    sheets = BOARDS.among(IDS).of(np.ones(len(IDS), dtype=bool))
    tags = true @ exp(rng.normal(0.0, 1e-4, (len(IDS), 6)))
    moved = rng.normal(0.0, 1e-5, (len(IDS), 6))

    def cost(scale):
        there = tags @ exp(scale * moved)
        sheet = sheets.fitted(there)
        return 0.5 * (sheet.squares * fitted.weights).sum()

    fitted = sheets.fitted(tags)
    slope = (fitted.weights[:, None] * sheets.information * fitted.off * moved).sum()
    assert (cost(1.0) - cost(-1.0)) / 2.0 == pytest.approx(slope, rel=0.02)
    one, other = sheets.pairs
    own = (fitted.weights[:, None] * sheets.information * moved**2).sum()
    shared = np.einsum("pi,pij,pj->", moved[one], sheets.couplings(fitted.weights), moved[other])
    assert cost(1.0) + cost(-1.0) - 2.0 * cost(0.0) == pytest.approx(own - shared, rel=0.1)


def test_sheets_may_hang_anywhere(room):
    true, _ = room
    sheets = BOARDS.among(IDS).of(np.ones(len(IDS), dtype=bool))
    moved = np.repeat(exp(np.random.default_rng(2).normal(0.0, 0.5, (SHEETS, 6))), EACH, axis=0) @ true
    np.testing.assert_allclose(sheets.fitted(moved).squares, sheets.fitted(true).squares, rtol=1e-6)
    assert np.abs(log(exp(sheets.fitted(true).off))).max() < 0.001


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("id,x,y\n1,0,0\n", "lacks the column board"),
        ("board,id,x,y\na,1,0,0\na,1,0,1\n", r"boards\.csv: id 1 belongs to 2 landmarks"),
        ("board,id,x,y\na,1.5,0,0\na,2,0,1\n", r"line 2: id must be a whole number from 0 to .*, got 1\.5"),
        ("board,id,x,y\na,1,0,0\na,2,0,1\nb,3,0,0\n", r"^boards has one tag only on board 'b'\.$"),
    ],
)
def test_files_that_tell_no_sheets_are_refused(tmp_path, text, message):
    (tmp_path / "boards.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        Boards.from_csv(tmp_path / "boards.csv", PRINTED)
