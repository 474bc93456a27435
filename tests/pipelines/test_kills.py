"""Runs that are killed: they end where they would have, their records are put right, and a history stays one run."""

import random
import re
import shlex
import shutil
import signal
import time

import pandas as pd
import pytest
from mlflow import MlflowClient
from support.processes import SETTINGS, call, command, ended, runs, wait_for
from support.thorough import SHARE

pytestmark = [pytest.mark.slow, pytest.mark.long]

KILLS = max(5, round(18 * SHARE))


def test_killed_at_random_moments_it_ends_where_it_would_have(begin, tmp_path):
    line = command("optimise", *SETTINGS, "budget.evaluations=5000", "threads=1", "checkpoint_seconds=0.05")
    code, _, err = ended(begin([*line, "hydra.run.dir=whole"], tmp_path))  # which compiles what the others load
    assert code == 0, err
    began = time.monotonic()
    life = begin([*line, "hydra.run.dir=first"], tmp_path)
    wait_for(tmp_path / "first" / "checkpoint.npz", life)
    start = time.monotonic() - began
    life.kill()
    life.wait()
    shutil.rmtree(tmp_path / "first")
    checkpoint, rng = tmp_path / "run" / "checkpoint.npz", random.Random(1)
    line += ["hydra.run.dir=run"]
    for kill in range(KILLS):
        life = begin([*line, *(["resume=run"] if checkpoint.exists() else [])], tmp_path)
        if checkpoint.exists() or kill < KILLS // 2:
            time.sleep(start * rng.uniform(0.2, 1.8))
        else:  # all have been killed before there was anything to go on from
            wait_for(checkpoint, life)
        life.kill()
        life.wait()
    assert checkpoint.exists()
    code, _, err = ended(begin([*line, "resume=run"], tmp_path))
    assert code == 0, err
    for name in ("landmarks.csv", "history.csv"):
        whole, kept = (pd.read_csv(tmp_path / folder / name) for folder in ("whole", "run"))
        pd.testing.assert_frame_equal(*(table.drop(columns="wall_time", errors="ignore") for table in (whole, kept)))
    assert (tmp_path / "run" / "landmarks.csv").read_bytes() == (tmp_path / "whole" / "landmarks.csv").read_bytes()
    assert {run.info.status for run in runs(tmp_path)} <= {"FINISHED", "FAILED"}
    finished = runs(tmp_path)[-1]
    assert finished.info.status == "FINISHED"
    client = MlflowClient(tracking_uri=f"sqlite:///{tmp_path}/store.db")
    curve = client.get_metric_history(finished.info.run_id, "best_fitness")
    assert max(point.step for point in curve) == 5000
    assert not list(tmp_path.rglob("*.partial*"))


def test_runs_are_listed_with_the_command_that_goes_on(begin, endless, tmp_path):
    process = endless()
    process.kill()
    process.communicate()
    listed = call("runs", "tracking.uri=sqlite:///store.db", settings=(), cwd=tmp_path)
    assert listed.returncode == 0, listed.stderr
    (run,) = runs(tmp_path)
    assert run.info.status == "FAILED"  # its process is gone
    assert run.info.run_name in listed.stdout
    (again,) = re.findall(r"^python -m pipelines\.optimise (.*)$", listed.stdout, re.MULTILINE)
    assert again.endswith(f"resume={tmp_path / 'run'}")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run", "store.db", "store.db.lock"]
    process = begin(command("optimise", *shlex.split(again), settings=()), tmp_path)
    saved = (tmp_path / "run" / "checkpoint.npz").stat().st_mtime_ns
    while (tmp_path / "run" / "checkpoint.npz").stat().st_mtime_ns == saved and process.poll() is None:
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    assert ended(process)[0] == 128 + signal.SIGINT
    (run,) = runs(tmp_path)
    assert (run.info.status, "reason" in run.data.tags) == ("KILLED", False)
