"""Score a deployment: `python -m pipelines.evaluate deployment=uniform|random|greedy|file [overrides]`."""

import time

import hydra
from omegaconf import DictConfig

from pipelines.app import CONF, build_problem, choices
from pipelines.sweep import run


@hydra.main(version_base="1.3", config_path=CONF, config_name="evaluate")
def main(cfg: DictConfig) -> float | None:
    """Score, record and show; returns the fitness."""
    return run(cfg, evaluate)


def evaluate(cfg: DictConfig) -> float:
    """Score the configured deployment."""
    import numpy as np

    from lmd.checks import integer
    from lmd.optimisers.base import Record
    from pipelines.recording import record, tracked_run

    began = time.perf_counter()
    problem = build_problem(cfg)
    seed = integer("seed", cfg.seed, low=0)
    deployment = problem.start.draw(problem.scene.room, np.random.default_rng(seed))
    history = [Record(1, problem.metrics(deployment)["fitness"], time.perf_counter() - began)]
    subject = choices()["deployment"]
    with tracked_run(cfg, problem, subject) as tracker:
        return record(cfg, problem, tracker, deployment, history, subject=subject, summary={})


if __name__ == "__main__":
    main()
