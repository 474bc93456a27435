"""Runs that are killed at random moments and go on: `python killed.py SEED KILLS OVERRIDE...`.

Starting a pipeline takes seconds, and this starts many: each is a fork of this process, which has imported everything
and compiled what it needs.
"""

import os
import random
import shutil
import signal
import sys
import time
from pathlib import Path

from small import problem

import lmd
from pipelines import optimise

RUN = Path("run")


def warm_up():
    """Import and compile what the forks need."""
    import mlflow.tracking.client  # noqa: F401

    from lmd.plot import convergence, page, scene  # noqa: F401

    lmd.optimise(problem(), evaluations=60)


def forked(overrides):
    """Start a run; returns its process."""
    child = os.fork()
    if child:
        return child
    goes_on = ["resume=run"] if (RUN / "checkpoint.npz").exists() else []
    sys.argv = ["optimise", *overrides, *goes_on, f"hydra.run.dir={RUN}"]
    log = os.open("log", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(log, 1)
    os.dup2(log, 2)
    optimise.main()
    os._exit(0)


def main():
    seed, kills, *overrides = sys.argv[1:]
    rng = random.Random(int(seed))
    warm_up()
    for _ in range(2):  # the first one also makes the store
        began = time.monotonic()
        os.waitpid(forked([*overrides, "budget.evaluations=1"]), 0)
        start = time.monotonic() - began
        shutil.rmtree(RUN)
    for _ in range(int(kills)):
        child = forked(overrides)
        time.sleep(start * rng.uniform(0.2, 1.5))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        print("killed after a checkpoint" if (RUN / "checkpoint.npz").exists() else "killed before", flush=True)
    _, status = os.waitpid(forked(overrides), 0)
    sys.exit(os.waitstatus_to_exitcode(status))


if __name__ == "__main__":
    main()
