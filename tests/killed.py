"""Runs that are killed at random moments and go on: `python killed.py PIPELINE SEED KILLS OVERRIDE...`.

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

from small import composed, problem

import lmd
from pipelines import optimise, place_cameras

RUN = Path("run")
MAINS = {"optimise": optimise.main, "place_cameras": place_cameras.main}
SHORTEST = {"optimise": ["budget.evaluations=1"], "place_cameras": ["budget.evaluations=1", "tag_evaluations=1"]}


def warm_up(pipeline, overrides):
    """Import and compile what the forks need."""
    import mlflow.tracking.client  # noqa: F401

    from lmd.plot import convergence, page, scene  # noqa: F401

    if pipeline == "optimise":
        lmd.optimise(problem(), evaluations=60)
        return
    cfg = composed(pipeline, *overrides, *SHORTEST[pipeline])
    cameras, _ = place_cameras.build_camera_problem(cfg)
    place_cameras.build_optimiser_of(cfg).run(cameras, lmd.Budget(1))


def forked(pipeline, overrides):
    """Start a run of a pipeline; returns its process."""
    child = os.fork()
    if child:
        return child
    goes_on = ["resume=run"] if (RUN / "checkpoint.npz").exists() else []
    sys.argv = [pipeline, *overrides, *goes_on, f"hydra.run.dir={RUN}"]
    log = os.open("log", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(log, 1)
    os.dup2(log, 2)
    MAINS[pipeline]()
    os._exit(0)


def main():
    pipeline, seed, kills, *overrides = sys.argv[1:]
    rng = random.Random(int(seed))
    warm_up(pipeline, overrides)
    for _ in range(2):  # the first one also makes the store
        began = time.monotonic()
        os.waitpid(forked(pipeline, [*overrides, *SHORTEST[pipeline]]), 0)
        start = time.monotonic() - began
        shutil.rmtree(RUN)
    for _ in range(int(kills)):
        child = forked(pipeline, overrides)
        time.sleep(start * rng.uniform(0.2, 1.5))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        print("killed after a checkpoint" if (RUN / "checkpoint.npz").exists() else "killed before", flush=True)
    _, status = os.waitpid(forked(pipeline, overrides), 0)
    sys.exit(os.waitstatus_to_exitcode(status))


if __name__ == "__main__":
    main()
