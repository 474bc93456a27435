"""A survey that a signal stops: it writes the current map, or nothing."""

import json
import signal
import sys

import numpy as np
import pandas as pd
import pytest
from support import walks
from support.processes import ended, wait_for

from lmd.formats.detection_formats import write_detections

SETTINGS = ["detections=detections.csv", "camera.path=camera.yaml", f"tag.edge={walks.EDGE}", "tracking=none",
            "hydra.run.dir=out"]  # fmt: skip
# The survey, but that it waits at some of its steps for as many signals, each time once the file `told N` is there.
WAITS = """
import time
from pathlib import Path
from pipelines import app, progress
from pipelines.operations import signals
from pipelines.survey import main

at, heard, observe, act = {at}, [], progress.Stages.__call__, signals.Stop._handle
def counted(self, number, frame):
    heard.append(number)
    act(self, number, frame)
def waiting(self, stage, done=0, most=0):
    observe(self, stage, done, most)
    if at and at[0] == (stage.name, done):
        at.pop(0)
        told = len(heard)
        Path(f"told {{told}}").touch()
        while len(heard) == told:
            time.sleep(0.01)
    return observe(self, stage, done, most)
signals.Stop._handle, progress.Stages.__call__ = counted, waiting
app.SHOWN_AFTER = 600.0  # on a loaded machine no survey is short
signals.stop.listen()
"""
pytestmark = pytest.mark.slow


@pytest.fixture
def told(begin, tmp_path):
    """Run a survey that gets a signal at each of some steps; returns its exit code, stdout and stderr."""
    rng = np.random.default_rng(3)
    tags = walks.spaced_tags(16, rng)
    walks.calibration(tmp_path / "camera.yaml", walks.CAMERA)
    write_detections(tmp_path / "detections.csv", walks.photographed(tags, walks.walk(25, rng), rng))

    def run(*at, number=signal.SIGINT):
        (tmp_path / "waits.py").write_text(WAITS.format(at=list(at)))
        process = begin([sys.executable, "-m", "waits", *SETTINGS], tmp_path)
        for count in range(len(at)):
            wait_for(tmp_path / f"told {count}", process)
            process.send_signal(number)
        return ended(process)

    return run


@pytest.mark.parametrize(
    "number",
    [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.thorough("pipelines/operations/signals.py"))],
)
def test_told_to_stop_while_the_map_is_refined_it_leaves_the_map_so_far(told, number, tmp_path):
    code, out, err = told(("REFINING", 1), number=number)
    assert code == 128 + number, err
    assert err == "\nstopping after this step; interrupt again to stop at once\n"
    assert "interrupted while refining the cameras: the map is not final, or later steps are missing" in out
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        ".hydra", "camera.yaml", "colmap", "frames.csv", "in_view.csv", "map.csv", "map.npz", "survey.json",
        "survey.png", "transforms.json",
    }  # fmt: skip
    document = json.loads((tmp_path / "out" / "survey.json").read_text())
    assert document["interrupted"] == "refining the cameras"
    table = pd.read_csv(tmp_path / "out" / "map.csv")
    assert len(table) == document["figures"]["tags"] >= 10
    assert (table.sigma > 0.0).all()


def test_told_to_stop_once_the_map_is_final_it_says_what_it_leaves_out(told):
    code, out, err = told(("HOLDING_OUT", 0))
    assert code == 128 + signal.SIGINT, err
    assert "interrupted while holding frames out: " in out
    assert "held out" not in out
    assert "next 1" not in out


@pytest.mark.parametrize(
    ("at", "doing"),
    [([("PLACING", 0)], "placing tags"), ([("REFINING", 1), ("CHECKING", 0)], "looking for faulty tags")],
)
def test_told_before_there_is_a_map_or_twice_it_leaves_nothing(told, at, doing, tmp_path):
    code, out, err = told(*at)
    assert code == 128 + signal.SIGINT, err
    assert err.endswith(f"\nstopping\ntold to stop while {doing}: nothing is written.\n")
    assert not out
    assert not (tmp_path / "out").exists()


def test_a_short_survey_that_is_not_told_to_stop_says_nothing_of_its_stages(told, tmp_path):
    code, out, err = told()
    assert (code, err) == (0, "")
    assert "interrupted" not in out
    assert json.loads((tmp_path / "out" / "survey.json").read_text())["interrupted"] is None
