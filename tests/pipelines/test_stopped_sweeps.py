"""Sweeps that are killed or stopped by a signal, with or without their jobs: the jobs that continue or stop."""

import json
import os
import re
import signal
import subprocess
import time

import pytest
from faulty_sweeps import prepared, runs, start_sweep, statuses, sweep, table
from mlflow import MlflowClient
from mlflow.entities import ViewType

pytestmark = pytest.mark.slow
THOROUGH = pytest.mark.thorough("pipelines/operations")


@pytest.fixture
def work(tmp_path):
    return prepared(tmp_path)


def test_a_sweep_killed_with_its_job_goes_on_with_what_is_missing(work):
    process = start_sweep(work, "none,slow")
    process.kill()
    os.kill(int((work / "pid").read_text()), signal.SIGKILL)
    process.communicate(timeout=60)
    parent, children = runs(work)
    assert parent.info.status == "RUNNING"
    assert statuses(children) == {"none": ["FINISHED"], "slow": ["RUNNING"]}

    (work / "repaired").touch()
    again = sweep(work, "none,slow")
    assert again.returncode == 0, again.stderr
    assert "done already: optimiser.fault=none" in again.stdout
    parent, children = runs(work)
    assert parent.info.status == "FINISHED"
    assert statuses(children) == {"none": ["FINISHED"], "slow": ["FINISHED"]}
    client = MlflowClient(tracking_uri=f"sqlite:///{work}/store.db")
    (lost,) = client.search_runs(["1"], run_view_type=ViewType.DELETED_ONLY)
    assert lost.data.tags["reason"] == "its process was killed, and the sweep with it"


@THOROUGH
def test_the_jobs_of_a_sweep_that_is_killed_under_joblib_stop(work):
    process = start_sweep(work, "slow", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2", tracking="tracking=none")
    process.kill()
    process.wait(timeout=60)
    (record,) = work.glob("outputs/optimise_sweep/*/*/job.json")
    deadline = time.monotonic() + 60
    while (status := json.loads(record.read_text())["status"]) == "running" and time.monotonic() < deadline:
        time.sleep(0.05)
    assert status == "interrupted"


def test_an_interrupted_job_goes_on_from_its_checkpoint(work):
    process = start_sweep(work, "slow,raise", "seed=0,1", stdout=subprocess.PIPE)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "0 of 4 jobs finished, 3 had not begun: " in out
    sittings = [table(work).seconds["slow"]]
    assert "the same command again does what is missing" in err
    parent, children = runs(work)
    assert (parent.info.status, parent.data.tags["reason"]) == ("KILLED", "the sweep was stopped")
    (child,) = children["slow"]
    assert child.info.status == "KILLED"
    assert table(work).reason["slow"] == "the sweep was stopped"
    (groups,) = work.glob("outputs/optimise_sweep/*/by_group.md")
    assert groups.read_text().startswith("| optimiser.fault |")  # no pivot of one key
    spent = child.data.metrics["evaluations"]
    assert 0 < spent < 400
    assert (parent.data.metrics["jobs"], parent.data.metrics["failed"]) == (4.0, 1.0)

    (work / "repaired").touch()
    again = sweep(work, "slow,raise", "seed=0,1")
    assert again.returncode == 0, again.stderr
    assert "4 of 4 jobs finished: " in again.stdout
    _, children = runs(work)
    assert statuses(children) == {"slow": ["FINISHED"] * 2, "raise": ["FINISHED"] * 2}
    (whole,) = [run for run in children["slow"] if run.info.run_id == child.info.run_id]
    assert whole.data.metrics["evaluations"] == 400
    assert "reason" not in whole.data.tags
    sittings += map(float, re.findall(r"finished in (\d+) s: optimiser.fault=slow seed=0", again.stdout))
    assert table(work).query("seed == 0").seconds["slow"] == pytest.approx(sum(sittings), abs=0.6)


@THOROUGH
def test_a_job_killed_under_submitit_does_not_lose_the_others(work):
    done = sweep(work, "none,kill", "hydra/launcher=submitit_local", tracking="tracking=none")
    assert done.returncode == 1
    assert "killed: optimiser.fault=kill: killed by SIGKILL" in done.stderr
    assert table(work).status.to_dict() == {"none": "finished", "kill": "killed"}
    (output,) = work.glob("outputs/optimise_sweep/*/fault-none_*/output.log")
    assert "threads 1 1 1\n" in output.read_text()
