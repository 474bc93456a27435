"""Share of the positions that see little: `python darkness.py deployment=random darkness.level=0.2`."""

import numpy as np
from omegaconf import DictConfig

from lmd.core.checks import real
from pipelines.building import build_problem
from pipelines.command import Command
from pipelines.study import Report, Study


def darkness(cfg: DictConfig) -> Study:
    """Prepare the study; what is refused is refused here, before anything is recorded."""
    problem, level = build_problem(cfg), real("darkness.level", cfg.darkness.level, low=0.0, high=1.0)
    deployment = problem.draw(np.random.default_rng(cfg.seed))

    def run(_: object) -> Report:
        """Files by their names, figures for mlflow, and lines for the terminal."""
        values = problem.values(deployment)
        dark = values < level
        table = dict(zip("xyz", problem.places[dark].T, strict=True)) | {"value": values[dark]}
        document = {"share": float(dark.mean()), "level": level}
        told = f"{dark.mean():.1%} of the positions see less than {level:g}"
        return Report({"darkness.csv": table, "darkness.json": document}, document, lines={"dark": told})

    return Study("darkness", run, problem=problem)


main = Command("darkness", darkness, like="evaluate", settings={"darkness": {"level": 0.1}})

if __name__ == "__main__":
    main()
