"""Sweeps with jobs that fail in a configured way, and the runs that they leave."""

import subprocess
import time
from textwrap import indent

import pandas as pd
from mlflow import MlflowClient
from processes import call, command, start

PLUGIN = """
import os, signal, sys, time
from pathlib import Path

from lmd.optimisers.random_search import RandomSearch


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
