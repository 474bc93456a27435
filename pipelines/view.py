"""Plan in the browser: `python -m pipelines.view [run=DIR] [overrides]`."""

import os
import secrets
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from omegaconf import DictConfig

from .app import run_directory
from .building import budget_of, build_optimiser, build_problem
from .earlier_run import read_earlier_run
from .export import build_export
from .operations.signals import CODES, stop
from .outputs import all_or_none
from .pipeline import Pipeline

if TYPE_CHECKING:
    from lmd.mapping.formats import Export
    from lmd.problem import Problem
    from lmd.scene.deployment import Deployment

UNSAVED = "unsaved.csv"


def view(cfg: DictConfig) -> None:
    """Let the configured deployment be changed in a browser."""
    import numpy as np

    from lmd.core.checks import integer
    from lmd.core.optional import optional
    from lmd.planner.app import Planner
    from lmd.planner.session import Session
    from lmd.planner.surveyed import Found

    optional("viser", "view")
    problem = build_problem(cfg)
    budget = budget_of(cfg)
    build_optimiser(cfg, cfg.seed).check(problem)  # what is wrong with it shows now, not at the first search
    tag, directory = problem.scene.tag, run_directory()
    nothing = tag.is_point and cfg.export is None  # of a point there is no map
    export = None if nothing else build_export(cfg, "export", tag)
    session = Session(problem, problem.draw(np.random.default_rng(cfg.seed)))
    session.warm_up()
    planner = Planner(
        session,
        integer("port", cfg.port, low=0, high=65535),
        save=lambda deployment: _save(directory, problem, export, deployment),
        optimiser=lambda: build_optimiser(cfg, cfg.seed),
        budget=budget,
        seed=cfg.seed if cfg.validate else None,
        survey=None if cfg.survey is None else Found.read(cfg.survey),
    )
    try:
        print(f"planner {planner.address} (Ctrl-C ends it)", flush=True)
        planner.run()
    finally:
        if not session.is_saved:  # first of all, whatever may be in the way of ending well
            _keep_unsaved(directory, session.deployment, ups=not tag.is_point)
        planner.close()


def _save(directory: Path, problem: "Problem", export: "Export | None", deployment: "Deployment") -> str:
    """Write landmarks.csv and what is exported, all or nothing; says where."""
    scene = problem.scene
    writers = export.writers(scene.room, scene.tag, deployment) if export else {}

    def write(folder: Path) -> None:
        deployment.to_csv(folder / "landmarks.csv", ups=not scene.tag.is_point)
        for name, write_one in writers.items():
            write_one(folder / name)

    with stop.postponed():
        files = all_or_none(directory, write)
    return f"{directory}: {', '.join(file.name for file in files)}"


def _keep_unsaved(directory: Path, deployment: "Deployment", ups: bool) -> None:
    """Write unsaved tags to the directory, or else to the working directory, the temporary directory, or stdout."""
    elsewhere = f"unsaved_{secrets.token_hex(4)}.csv"

    def write(name: str, folder: Path) -> None:
        deployment.to_csv(folder / name, ups)

    for place, name in ((str(directory), UNSAVED), (os.curdir, elsewhere), ("", elsewhere)):
        try:
            folder = Path(place or tempfile.gettempdir())  # there may be none
            (file,) = all_or_none(folder.resolve(), partial(write, name))
        except OSError as error:
            print(f"changes that were not saved cannot be written ({error})", file=sys.stderr)
        else:
            print(f"changes that were not saved are in {file}", file=sys.stderr)
            return
    print("the tags as they are now:", flush=True)
    deployment.to_csv(sys.stdout, ups)
    sys.stdout.flush()


command = Pipeline("view", view, (read_earlier_run,))


def main() -> None:
    """Serve until told to stop."""
    try:
        command()
    except SystemExit as ended:
        if ended.code in CODES:  # Python would wait for threads that compile
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(int(ended.code))
        raise


if __name__ == "__main__":
    main()
