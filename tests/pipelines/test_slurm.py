"""A sweep on a real SLURM cluster, which ends some of its jobs, against a real mlflow server."""

import os
import signal
import subprocess
from functools import partial

import pandas as pd
import pytest
import slurm
from faulty_sweeps import by_fault, prepared, statuses
from mlflow import MlflowClient
from processes import WHOLE, command, start
from services import mlflow_server, wait_until

# Takes its time until the file `repaired` is there; as `late` it hangs in a batch once it has a checkpoint.
FAILS = """\
with open(f"batches_{self.fault}", "a") as file:
    file.write(f"{os.getpid()} {self.ledger.evaluations}\\n")
if self.fault != "none" and not Path("repaired").exists():
    hangs = self.fault == "late" and Path(os.environ["LMD_JOB"], "checkpoint.npz").exists()
    time.sleep(600 if hangs else 1)
"""
FAULTS = ("cancelled", "late", "none", "queued")
IDS = {fault: f"1_{number}" for number, fault in enumerate(FAULTS)}  # in SLURM: a fresh cluster's first array
BATCHES = 40
REASON = slurm.missing()
pytestmark = [
    pytest.mark.long, pytest.mark.slow, pytest.mark.thorough("pipelines/operations"),
    pytest.mark.skipif(REASON is not None, reason=str(REASON)),
]  # fmt: skip


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    home = tmp_path_factory.mktemp("server")
    with mlflow_server(f"sqlite:///{home}/store.db", home) as address:
        yield address


@pytest.fixture(scope="module")
def cwd(tmp_path_factory):
    """A working directory with the optimiser `faulty`."""
    return prepared(tmp_path_factory.mktemp("work"), FAILS)


@pytest.fixture(scope="module")
def sweep(cwd, server):
    """Starts a sweep of four jobs, two at a time, on a cluster of its own."""
    line = command(
        "optimise", "hydra.mode=MULTIRUN", f"hydra.searchpath=[file://{cwd}/mine]", "deployment.count=20",
        f"budget.evaluations={10 * BATCHES}", "checkpoint_seconds=1", f"tracking.uri={server}", "optimiser=faulty",
        f"optimiser.fault={','.join(FAULTS)}", "hydra/launcher=slurm",
    )  # fmt: skip
    with slurm.cluster(cpus=2, kill_wait=2):
        yield lambda: start(line, cwd=cwd, folders=[cwd], stdout=subprocess.PIPE, stderr=subprocess.PIPE)


@pytest.fixture(scope="module")
def cut(cwd, server, sweep):
    """The output of the sweep, its table and its runs, after SLURM has ended three of its jobs."""
    process = sweep()
    queue = partial(slurm.ask, "squeue", "--states=all")
    wait_until(lambda: all(checkpoint(cwd, fault) for fault in ("cancelled", "late")), process, queue)
    slurm.ask("scancel", IDS["cancelled"], IDS["queued"])
    slurm.ask("scontrol", "update", f"JobId={IDS['late']}", "EndTime=now")
    wait_until(lambda: queue(f"--jobs={IDS['late']}", "--noheader", "--format=%T") == "TIMEOUT\n", process, queue)
    # SLURM has killed the process that waited for this one. With control groups, which a test cannot have, both die.
    os.kill(batches(cwd, "late")[-1][0], signal.SIGKILL)
    out, err = process.communicate(timeout=WHOLE)
    return process.returncode, out, err, table(cwd), runs(server)


def checkpoint(cwd, fault):
    return list(cwd.glob(f"outputs/optimise_sweep/*/fault-{fault}_*/checkpoint.npz"))


def batches(cwd, fault):
    """The process of each batch that a job was told, and its evaluations by then; one that goes on is told again."""
    return [tuple(map(int, line.split())) for line in (cwd / f"batches_{fault}").read_text().splitlines()]


def table(cwd):
    (path,) = cwd.glob("outputs/optimise_sweep/*/jobs.csv")
    return pd.read_csv(path, keep_default_na=False).set_index("optimiser.fault")


def runs(server):
    """The parent run, and those below it by what they were told to do."""
    client = MlflowClient(tracking_uri=server)
    return by_fault(client.search_runs([client.get_experiment_by_name("lmd").experiment_id]))


def test_jobs_that_slurm_ends_do_not_lose_the_others_and_the_sweep_names_them(cut):
    code, out, err, rows, _ = cut
    assert code == 1
    assert "1 of 4 jobs finished" in out
    assert rows.status.to_dict() == {
        "none": "finished", "cancelled": "interrupted", "late": "killed", "queued": "killed"
    }  # fmt: skip
    assert rows.reason["cancelled"] == "SLURM says CANCELLED"
    assert rows.reason["late"].startswith("SLURM says TIMEOUT")
    assert rows.reason["queued"] == "it left SLURM's queue"
    for fault in ("cancelled", "late", "queued"):
        assert f"{rows.status[fault]}: optimiser.fault={fault}: {rows.reason[fault]} (" in err
    assert "sacct" not in err  # there is no accounting


@pytest.mark.usefixtures("cut")
def test_slurm_itself_killed_the_late_job(cwd):
    (log,) = cwd.glob(f"outputs/optimise_sweep/*/.submitit/{IDS['late']}/*.err")
    assert "DUE TO TIME LIMIT" in log.read_text()


def test_their_runs_say_why(cut):
    *_, (parent, children) = cut
    assert (parent.info.status, parent.data.tags["reason"]) == ("FAILED", "3 of 4 jobs failed")
    assert statuses(children) == {
        "none": ["FINISHED"], "cancelled": ["KILLED"], "late": ["FAILED"], "queued": ["FAILED"]
    }  # fmt: skip
    assert children["late"][0].data.tags["reason"].startswith("SLURM says TIMEOUT")
    assert children["queued"][0].data.tags["reason"] == "it left SLURM's queue"


def test_the_same_sweep_again_does_what_is_missing_from_the_checkpoints(cut, cwd, server, sweep):
    *_, (_, before) = cut
    (cwd / "repaired").touch()
    process = sweep()
    out, err = process.communicate(timeout=WHOLE)
    assert process.returncode == 0, err
    assert "going on after 1 finished jobs" in out
    assert "4 of 4 jobs finished" in out
    parent, children = runs(server)
    assert parent.info.status == "FINISHED"
    assert statuses(children) == {
        "none": ["FINISHED"], "cancelled": ["FINISHED"], "late": ["FINISHED"], "queued": ["FAILED", "FINISHED"]
    }  # fmt: skip
    for fault in ("cancelled", "late"):
        assert children[fault][0].info.run_id == before[fault][0].info.run_id
        assert len({process for process, _ in batches(cwd, fault)}) == 2
    for fault in ("none", "cancelled", "late"):
        assert sorted({spent for _, spent in batches(cwd, fault)}) == [10 * i for i in range(1, BATCHES + 1)]
    for found in children.values():
        (finished,) = [run for run in found if run.info.status == "FINISHED"]
        assert finished.data.metrics["evaluations"] == 10 * BATCHES
        assert "reason" not in finished.data.tags
