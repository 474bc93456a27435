"""Tags on printed sheets; some 5 seconds in all."""

from dataclasses import replace

import numpy as np
import pytest
from support import walks

from lmd.core.checks import InputError
from lmd.geometry.se3 import exp
from lmd.survey.knowledge import Boards

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


def spacing(found, true):
    """Median error of the distances of tags from the first one on their sheet, metres."""
    here, there = (
        np.linalg.norm(places[:, 1:] - places[:, :1], axis=2)
        for places in (poses[:, :3, 3].reshape(SHEETS, EACH, 3) for poses in (found.found.poses.tags, true))
    )
    return np.median(np.abs(here - there))


def test_boards_reduce_errors_and_covariances(room):
    true, detected = room
    boards, alone = (walks.surveyed(detected, SIGMA, boards=given) for given in (BOARDS, None))
    assert spacing(boards, true) < 0.7 * spacing(alone, true)
    assert np.median(boards.found.sigmas) < np.median(alone.found.sigmas)


def test_a_tag_at_a_wrong_place_of_its_sheet_does_no_harm(room):
    true, detected = room
    places = BOARDS.places.copy()
    places[5] += 0.05
    found = walks.surveyed(detected, SIGMA, boards=replace(BOARDS, places=places))
    assert found.placed.all()
    assert spacing(found, true) < 0.001


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("id,x,y\n1,0,0\n", "lacks the column board"),
        ("board,id,x,y\na,1,0,0\na,1,0,1\n", r"boards\.csv: id 1 belongs to 2 landmarks"),
        ("board,id,x,y\na,1.5,0,0\na,2,0,1\n", r"line 2: id must be a whole number from 0 to .*, got 1\.5"),
        (
            "board,id,x,y\na,1,0,0\na,2,0,1\nb,3,0,0\n",
            r"^boards: 'b' has only one tag\.$",
        ),
    ],
)
def test_files_without_valid_sheets_are_refused(tmp_path, text, message):
    (tmp_path / "boards.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        Boards.from_csv(tmp_path / "boards.csv", PRINTED)
