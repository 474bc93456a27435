"""Runs that a signal stops: their files and messages."""

import re
import signal
import time

import pandas as pd
import pytest
from support.processes import ENDLESS, ROOT, SETTINGS, WHOLE, command, ended, metrics_in, runs

pytestmark = [pytest.mark.slow, pytest.mark.long]

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
THOROUGH = pytest.mark.thorough("pipelines/__init__.py", "pipelines/operations/signals.py", "pipelines/optimise.py")


@pytest.mark.parametrize("number", [SIGNALS[0], *(pytest.param(each, marks=THOROUGH) for each in SIGNALS[1:])])
def test_told_to_stop_it_keeps_the_best_and_says_how_to_go_on(endless, number, tmp_path):
    process = endless()
    process.send_signal(number)
    code, _, err = ended(process)
    assert code == 128 + number
    assert "stopping after this batch" in err
    first = metrics_in(tmp_path / "run")
    assert first["stopped"] == "interrupted"
    assert first["fitness"] == pd.read_csv(tmp_path / "run" / "history.csv").best_fitness.max()
    (run,) = runs(tmp_path)
    assert run.info.status == "KILLED"
    (again,) = re.findall(r"resume with: python -m pipelines\.optimise (.*)", err)
    assert again.endswith(f"resume={tmp_path / 'run'}")
    assert not {".reserve", "tracking.jsonl"} & {path.name for path in (tmp_path / "run").iterdir()}


def test_told_twice_it_stops_at_once_and_keeps_the_best(endless, tmp_path):
    process = endless("validate=true")
    process.send_signal(signal.SIGINT)
    process.send_signal(signal.SIGTERM)
    process.send_signal(signal.SIGINT)
    assert ended(process)[0] in {128 + number for number in SIGNALS}
    assert len(pd.read_csv(tmp_path / "run" / "landmarks.csv")) == 40
    assert 0.0 < metrics_in(tmp_path / "run")["fitness"] <= 1.0
    (run,) = runs(tmp_path)
    assert run.info.status == "KILLED"
    assert run.data.metrics["fitness"] == metrics_in(tmp_path / "run")["fitness"]


@THOROUGH
@pytest.mark.parametrize(
    ("number", "delay"),
    [*((signal.SIGINT, delay) for delay in (0.05, 0.3, 0.8, 2.5)), (signal.SIGTERM, 1.5), (signal.SIGHUP, 0.8)],
)
def test_told_to_stop_before_there_is_anything_it_leaves_nothing(begin, number, delay, tmp_path):
    process = begin(command("optimise", *SETTINGS, *ENDLESS), tmp_path, fresh=True)
    time.sleep(delay)
    process.send_signal(number)
    _, err = process.communicate(timeout=WHOLE)
    # Before it reads our first line, Python has a traceback of its own, and an exit code of its own while it starts.
    assert "Traceback" not in err or f"{ROOT}/pipelines" not in err
    codes = {128 + number, -number} | ({1} if "Traceback" in err and f"{ROOT}/pipelines" not in err else set())
    left = {path.name for path in (tmp_path / "run").iterdir()} if (tmp_path / "run").exists() else set()
    if "checkpoint.npz" not in left:
        assert process.returncode in codes, err
        assert not left or "landmarks.csv" in left
    if (tmp_path / "store.db").exists():
        assert not [run for run in runs(tmp_path) if run.info.status == "RUNNING"]
