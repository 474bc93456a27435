"""Sweeps as a user meets them: what they leave, what a failing job does to the others, and doing what is missing."""

import json
import os
import re
import signal
import subprocess
import time
from textwrap import indent

import pandas as pd
import pytest
from mlflow import MlflowClient
from support.processes import call, command, start

PLUGIN = """
import os, signal, sys, time
from pathlib import Path

from lmd.optimisers.genetic import RandomSearch


class Faulty(RandomSearch):
    def __init__(self, fault, seed=0):
        super().__init__(10, seed=seed, encoding="wall")
        self.fault = fault

    def _tell(self, genes, fitness):
"""
# It fails in the configured way after its first evaluations, until the file `repaired` exists.
FAILS = """\
print("threads", *(os.environ.get(f"{name}_NUM_THREADS") for name in ("NUMBA", "OMP", "MKL")))
if Path("repaired").exists():
    return
if self.fault == "raise":
    raise ValueError("no such luck")
if self.fault == "exit":
    sys.exit(3)
if self.fault == "kill":
    os.kill(os.getpid(), signal.SIGKILL)
if self.fault == "slow":
    Path("own").write_text(str(os.getpid()))
    Path("own").rename("pid")  # whoever waits for the file finds it whole
    time.sleep(0.3)
"""
PARENT = "mlflow.parentRunId"
STORE = "tracking.uri=sqlite:///store.db"


def prepared(cwd, fails=FAILS):
    """A working directory with the optimiser `faulty`, which `fails` where it is told what its genes are worth."""
    (cwd / "mine" / "optimiser").mkdir(parents=True)
    (cwd / "mine" / "optimiser" / "faulty.yaml").write_text("_target_: faulty.Faulty\nfault: none\n")
    (cwd / "faulty.py").write_text(PLUGIN + indent(fails, 8 * " "))
    return cwd


def settings(cwd, faults, tracking=STORE):
    return [
        "hydra.mode=MULTIRUN", f"hydra.searchpath=[file://{cwd}/mine]", "deployment.count=20",
        "budget.evaluations=400", tracking, "optimiser=faulty", f"optimiser.fault={faults}",
    ]  # fmt: skip


def sweep(cwd, faults, *overrides, tracking=STORE):
    return call("optimise", *settings(cwd, faults, tracking), *overrides, cwd=cwd, folders=[cwd])


def start_sweep(cwd, faults, *overrides, tracking=STORE, **streams):
    """Start a sweep and wait until its slow job is at work."""
    line = command("optimise", *settings(cwd, faults, tracking), *overrides)
    process = start(line, cwd=cwd, folders=[cwd], stderr=subprocess.PIPE, **streams)
    deadline = time.monotonic() + 120
    while not (cwd / "pid").exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    return process


def runs(cwd):
    """The parent run of the only sweep, and its child runs by their configured fault."""
    return by_fault(found_in(cwd))


def by_fault(found):
    """The parent run of one sweep, and its child runs by their configured fault."""
    (parent,) = [run for run in found if PARENT not in run.data.tags]
    children = {}
    for run in found:
        if run is not parent:
            assert run.data.tags[PARENT] == parent.info.run_id
            children.setdefault(run.data.tags["override.optimiser.fault"], []).append(run)
    return parent, children


def table(cwd):
    (path,) = cwd.glob("outputs/optimise_sweep/*/jobs.csv")
    return pd.read_csv(path).set_index("optimiser.fault")


def statuses(children):
    return {fault: sorted(run.info.status for run in found) for fault, found in children.items()}


def told_by(run):
    return run.data.tags["mlflow.note.content"]


def found_in(cwd):
    return MlflowClient(tracking_uri=f"sqlite:///{cwd}/store.db").search_runs(["1"])


pytestmark = pytest.mark.slow
QUICK = ("localisation=false", "losses=false")
THOROUGH = pytest.mark.thorough("pipelines/operations")
REASONS = {
    "none": None,
    "raise": "ValueError: no such luck",
    "exit": "exited with code 3 before it had finished",
    "kill": "killed by SIGKILL",
}


@pytest.fixture(scope="module")
def faulty(tmp_path_factory):
    """A sweep of four jobs under joblib, three of which fail."""
    cwd = prepared(tmp_path_factory.mktemp("faulty"))
    return cwd, sweep(cwd, ",".join(REASONS), "hydra/launcher=joblib", "hydra.launcher.n_jobs=2")


def artifacts(client, run):
    return [file.path for file in client.list_artifacts(run.info.run_id)]


def test_failing_jobs_do_not_lose_the_others_and_the_sweep_names_them(faulty):
    cwd, done = faulty
    assert done.returncode == 1
    assert "1 of 4 jobs finished" in done.stdout
    for fault, reason in REASONS.items():
        said = f"{'killed' if fault == 'kill' else 'failed'}: optimiser.fault={fault}: {reason}"
        assert (said in done.stderr) == (fault != "none")
    rows = table(cwd)
    assert rows.status.to_dict() == {"none": "finished", "raise": "failed", "exit": "failed", "kill": "killed"}
    assert rows.qualified_ratio.notna().to_dict() == {fault: fault == "none" for fault in REASONS}
    (output,) = cwd.glob("outputs/optimise_sweep/*/fault-none_*/output.log")
    assert "threads 1 1 1\n" in output.read_text()  # jobs share the machine


def test_a_sweep_is_one_parent_run_with_a_child_for_each_job(faulty):
    cwd, done = faulty
    parent, children = runs(cwd)
    assert parent.info.run_name.startswith("fault spacing=1.5 ")
    assert parent.info.run_name.endswith(f" count=20 evaluations=400 optimiser=faulty #{parent.info.run_id[:4]}")
    told = told_by(parent)
    assert told.startswith("**FAILED**: 3 of 4 jobs failed\n\n1 of 4 jobs finished\n\n| optimiser.fault |")
    assert re.search(r"\n\| none \| 1 of 1 \| [\d.]+% \| [\d.]+% \|\n\| raise \| 0 of 1 \|  \|  \|\n", told)
    assert (parent.info.status, parent.data.tags["reason"]) == ("FAILED", "3 of 4 jobs failed")
    assert (parent.data.metrics["jobs"], parent.data.metrics["failed"]) == (4.0, 3.0)
    assert parent.data.metrics["median/qualified_ratio"] == table(cwd).qualified_ratio["none"]  # of the best group
    client = MlflowClient(tracking_uri=f"sqlite:///{cwd}/store.db")
    assert artifacts(client, parent) == ["by_group.md", "groups.png", "jobs.csv"]
    for mode in ("TABLE", "CHART"):  # views of the jobs, grouped by what varies
        assert f"&compareRunsMode={mode}&viewStateShareKey={parent.info.run_id}" in done.stdout
    assert f"mlflow.sharedViewState.{parent.info.run_id}" in client.get_experiment("1").tags
    assert statuses(children) == {"none": ["FINISHED"], "raise": ["FAILED"], "exit": ["FAILED"], "kill": ["FAILED"]}
    assert {fault: found[0].data.tags.get("reason") for fault, found in children.items()} == REASONS
    assert all("output.log" in artifacts(client, found[0]) for found in children.values())
    assert {found[0].data.params["deployment.count"] for found in children.values()} == {"20"}  # of failed jobs, too
    (child,) = children["none"]
    assert child.info.run_name.startswith("fault=none faulty spacing=1.5 ")
    tags = child.data.tags
    assert (tags["sweep"], tags["pipeline"], tags["job"]) == ("optimiser.fault", "optimise", table(cwd).folder["none"])
    assert not re.search("run.dir|resume", tags["command"])  # repeated by hand it writes to no folder of the sweep


def test_the_same_sweep_again_does_only_what_is_missing(faulty):
    cwd, _ = faulty
    (folder,) = (cwd / "outputs" / "optimise_sweep").iterdir()
    untouched = folder / table(cwd).folder["none"] / "metrics.json"
    before = untouched.stat().st_mtime_ns
    (cwd / "repaired").touch()
    damaged = folder / table(cwd).folder["raise"] / "job.json"
    damaged.write_text(damaged.read_text()[:100])
    again = sweep(cwd, ",".join(REASONS))
    assert again.returncode == 0, again.stderr
    assert f"warning: {damaged.relative_to(cwd)} is damaged (JSONDecodeError" in again.stderr
    assert "continuing after 1 finished jobs" in again.stdout
    assert "done already: optimiser.fault=none" in again.stdout
    assert again.stdout.count("finished in") == 3
    assert (table(cwd).status == "finished").all()
    assert untouched.stat().st_mtime_ns == before
    parent, children = runs(cwd)
    assert (parent.info.status, "reason" in parent.data.tags) == ("FINISHED", False)
    assert statuses(children) == {fault: ["FINISHED"] for fault in REASONS}  # none of the attempts before


def sweep_n(cwd, values):
    overrides = ("hydra.mode=MULTIRUN", f"objective.n={values}", "validate=true", "tracking.uri=sqlite:///store.db")
    return call("evaluate", *overrides, *QUICK, cwd=cwd)


def test_a_sweep_grows_by_values_without_the_one_that_is_refused(tmp_path):
    done = sweep_n(tmp_path, "2,500")
    assert done.returncode == 1
    assert "objective.n = 500 exceeds the number of landmarks, 90" in done.stderr
    grown = sweep_n(tmp_path, "3,2")
    assert grown.returncode == 0, grown.stderr
    assert "continuing after 1 finished jobs" in grown.stdout
    assert re.search(r"^finished in \d+ s: objective.n=3$", grown.stdout, re.M)
    assert grown.stdout.count("done already: objective.n=2") == 1
    (table,) = tmp_path.glob("outputs/evaluate_sweep/*/jobs.csv")
    rows = pd.read_csv(table)
    assert rows["objective.n"].tolist() == [3, 2]  # those of the last command in its order; 500 is asked no more
    figures = [json.loads((table.parent / name / "metrics.json").read_text()) for name in rows.folder]
    assert rows.off_grid.tolist() == [metrics["off_grid"] for metrics in figures]
    (parent,) = [run for run in found_in(tmp_path) if PARENT not in run.data.tags]
    assert (parent.info.status, parent.data.metrics["jobs"]) == ("FINISHED", 2.0)


def test_a_sweep_that_cannot_be_composed_leaves_nothing(tmp_path):
    done = call("optimise", "hydra.mode=MULTIRUN", "optimiser=ega,egg", "tracking.uri=sqlite:///store.db", cwd=tmp_path)
    assert done.returncode == 1
    assert "Could not find 'optimiser/egg'" in done.stderr
    assert not list((tmp_path / "outputs" / "optimise_sweep").iterdir())
    assert not MlflowClient(tracking_uri=f"sqlite:///{tmp_path}/store.db").search_runs(["1"])


def test_a_stored_sweep_can_be_narrowed_and_a_changed_file_makes_another_sweep(tmp_path):
    quick = ("tracking=none", *QUICK)
    done = call("evaluate", "experiment=table2_baselines", "seed=0", "deployment=uniform", *quick, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (landmarks,) = tmp_path.glob("outputs/evaluate_sweep/table2_baselines-*/*/landmarks.csv")
    (tmp_path / "mine.csv").write_bytes(landmarks.read_bytes())
    for count in (1, 2):
        narrowed = ("experiment=table3", "objective.n=2,3", "deployment.path=mine.csv")
        done = call("evaluate", *narrowed, *quick, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert len(list(tmp_path.glob("outputs/evaluate_sweep/table3-*"))) == count
        (tmp_path / "mine.csv").write_text("\n".join((tmp_path / "mine.csv").read_text().splitlines()[:-1]) + "\n")
    for jobs in tmp_path.glob("outputs/evaluate_sweep/table3-*/jobs.csv"):
        rows = pd.read_csv(jobs)
        assert rows["objective.n"].tolist() == [2, 3]  # thold_p is given on the command line
        assert rows.average_coverage_probability.is_monotonic_decreasing


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


def test_an_interrupted_job_goes_on_from_its_checkpoint(work):
    process = start_sweep(work, "slow,raise", "seed=0,1", stdout=subprocess.PIPE)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "0 of 1 jobs finished: " in out
    sittings = [table(work).seconds["slow"]]
    assert "run the same command again to finish it" in err
    parent, children = runs(work)
    assert (parent.info.status, parent.data.tags["reason"]) == ("KILLED", "the sweep was stopped")
    (child,) = children["slow"]
    assert child.info.status == "KILLED"
    assert table(work).reason["slow"] == "the sweep was stopped"
    assert 0 < child.data.metrics["evaluations"] < 400

    (work / "repaired").touch()
    again = sweep(work, "slow,raise", "seed=0,1")
    assert again.returncode == 0, again.stderr
    assert "4 of 4 jobs finished: " in again.stdout
    _, children = runs(work)
    assert statuses(children) == {"slow": ["FINISHED"] * 2, "raise": ["FINISHED"] * 2}
    (whole,) = [run for run in children["slow"] if run.info.run_id == child.info.run_id]
    assert whole.data.metrics["evaluations"] == 400
    sittings += map(float, re.findall(r"finished in (\d+) s: optimiser.fault=slow seed=0", again.stdout))
    assert table(work).query("seed == 0").seconds["slow"] == pytest.approx(sum(sittings), abs=0.6)


@THOROUGH
def test_a_job_killed_under_submitit_does_not_lose_the_others(work):
    done = sweep(work, "none,kill", "hydra/launcher=submitit_local", tracking="tracking=none")
    assert done.returncode == 1
    assert "killed: optimiser.fault=kill: killed by SIGKILL" in done.stderr
    assert table(work).status.to_dict() == {"none": "finished", "kill": "killed"}
