"""Planner in the browser: `python -m pipelines.view [run=DIR] [overrides]`."""

import os
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from .app import run_directory
from .building import budget_of, build_optimiser, build_problem, refuse_crowd
from .command import Command
from .export import build_export
from .operations.signals import CODES, stop
from .outputs import write_all
from .study import LANDMARKS

if TYPE_CHECKING:
    from lmd.planner.plan import Plan


def view(cfg: DictConfig) -> None:
    """Serve the planner for the configured deployment in the browser, until a signal ends it."""
    import numpy as np

    from lmd.core.checks import integer
    from lmd.core.optional import optional
    from lmd.planner.server import Planner
    from lmd.planner.session import PlanningSession

    optional("viser", "view")
    problem = build_problem(cfg)
    refuse_crowd(problem, "view")
    budget, directory, tag = budget_of(cfg), run_directory(), problem.scene.tag
    build_optimiser(cfg, cfg.seed).check(problem)  # checked before the first search
    # Points cannot be exported as a map.
    export = None if tag.is_point and cfg.export is None else build_export(cfg, "export", tag)
    session = PlanningSession(problem, problem.draw(np.random.default_rng(cfg.seed)))
    session.warm_up()

    def save(plan: "Plan") -> str:
        files: dict[str, Any] = {LANDMARKS: partial(plan.deployment.to_csv, ups=not tag.is_point)}
        files |= export.writers(problem.scene.room, tag, plan.deployment) if export else {}
        with stop.postponed():
            return f"{directory}: {', '.join(file.name for file in write_all(directory, files))}"

    planner = Planner(
        session,
        integer("port", cfg.port, low=0, high=65535),
        save=save,
        optimiser=lambda: build_optimiser(cfg, cfg.seed),
        budget=budget,
        seed=cfg.seed if cfg.validate else None,
    )
    try:
        print(f"planner {planner.address} (Ctrl-C ends it)", flush=True)
        planner.run()
    finally:
        if not session.is_saved:  # saved first, as closing may fail
            _keep_unsaved(directory, session.plan, ups=not tag.is_point)
        planner.close()


def _keep_unsaved(directory: Path, plan: "Plan", ups: bool) -> None:
    """Write the unsaved tags of the plan to the run's directory or, if that fails, to a temporary directory."""
    for place in (directory.resolve, partial(tempfile.mkdtemp, prefix="lmd_")):
        try:
            (written,) = write_all(Path(place()), {"unsaved.csv": partial(plan.deployment.to_csv, ups=ups)})
        except OSError as error:
            print(f"changes that were not saved cannot be written ({error})", file=sys.stderr)
        else:
            print(f"changes that were not saved are in {written}", file=sys.stderr)
            return


command = Command("view", view)


def main() -> None:
    """Run the command; after a signal, end the process immediately."""
    try:
        command()
    except SystemExit as ended:
        if ended.code not in CODES:
            raise
        sys.stdout.flush()
        os._exit(int(ended.code))  # otherwise Python would wait for threads that are compiling


if __name__ == "__main__":
    main()
