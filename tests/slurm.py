"""A SLURM cluster of one node, which is its controller too, for as long as a test needs it."""

import getpass
import os
import secrets
import shutil
import subprocess
import tempfile
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

import pytest
from services import free_port, service, wait_until

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "srun", "squeue", "scancel", "scontrol")
PACKAGES = "munge slurmctld slurmd slurm-client"
ADMINISTRATION = "/usr/sbin:/sbin"  # where Debian keeps the daemons, off a user's PATH
CONF = """\
ClusterName=lmd
SlurmctldHost=localhost
SlurmctldPort={controller}
SlurmdPort={worker}
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
CredType=cred/munge
AuthInfo=socket={home}/munge.socket
StateSaveLocation={home}/state
SlurmdSpoolDir={home}/spool
SlurmctldPidFile={home}/slurmctld.pid
SlurmdPidFile={home}/slurmd.pid
# Nothing here needs control groups or a database, which a test machine may not have.
ProctrackType=proctrack/pgid
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SwitchType=switch/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SlurmdParameters=config_overrides
SchedulerParameters=batch_sched_delay=0
ReturnToService=2
KillWait={kill_wait}
NodeName=localhost CPUs={cpus} RealMemory=65536
PartitionName=test Nodes=localhost Default=YES MaxTime=INFINITE
"""


def missing():
    """Why there can be no cluster here, if there cannot."""
    absent = [name for name in PROGRAMS if _program(name) is None]
    return f"{', '.join(absent)} not installed (Debian: apt-get install {PACKAGES})" if absent else None


def _program(name):
    return shutil.which(name, path=f"{os.environ['PATH']}:{ADMINISTRATION}")


@contextmanager
def cluster(cpus, kill_wait):
    """While entered, SLURM's commands reach a cluster of its own.

    Args:
        cpus: of the node, however many there are in truth.
        kill_wait: seconds between SIGTERM and SIGKILL for a job that has to end.
    """
    with ExitStack() as stack:
        home = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="lmd_slurm_")))
        for folder in ("state", "spool"):
            (home / folder).mkdir()
        conf, key = home / "slurm.conf", home / "munge.key"
        user, controller, worker = getpass.getuser(), free_port(), free_port()
        conf.write_text(CONF.format(**locals()))
        key.touch(mode=0o600)
        key.write_bytes(secrets.token_bytes(128))
        stack.enter_context(pytest.MonkeyPatch.context()).setenv("SLURM_CONF", str(conf))

        munge = ["--foreground", "--force", f"--key-file={key}", f"--socket={home}/munge.socket"]
        munge += [f"--{file}-file={home}/munge.{file}" for file in ("pid", "log", "seed")]
        daemons = {
            "munged": (munge, (home / "munge.socket").exists),
            "slurmctld": (["-D"], lambda: "is UP" in ask("scontrol", "ping")),
            "slurmd": (["-D", "-N", "localhost"], lambda: "idle" in ask("sinfo", "--noheader", "--format=%T")),
        }
        for daemon, (options, up) in daemons.items():
            stack.enter_context(service([_program(daemon), *options], up, home / f"{daemon}.out"))
        try:
            yield
        finally:  # what still belongs to a job, and has its socket here, would wait for a controller for ever
            ask("scancel", f"--user={user}")
            sockets = partial((home / "spool").glob, "localhost_*")
            wait_until(lambda: not (ask("squeue", "--noheader") or list(sockets())), report=partial(ask, "squeue"))


def ask(*command):
    """Output of one of SLURM's commands."""
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout
