"""Report on the stored sweeps: `python -m pipelines.report [tracking.uri=...] [sweeps=[ID,...]] [save_as=PATH]`."""

import shutil
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from .app import run_directory, save_path, say
from .building import build_problem
from .command import Command, alone
from .composing import GROUPS
from .outputs import all_or_none
from .trust import Trust, read_yaml

if TYPE_CHECKING:
    import pandas as pd

    from lmd.problem import Problem
    from lmd.scene.deployment import Deployment

    from .operations.tracking import MlflowReader

TITLE = "The paper's tables and figures, reproduced"
MARK = "<!-- What follows is written by python -m pipelines.report and overwritten by it. -->"


def report(cfg: DictConfig) -> None:
    """Write report.md and its pictures to the run directory."""
    from lmd.core.checks import InputError

    from .operations.tracking import MlflowReader
    from .reproduction.sections import sections
    from .reproduction.source import Source

    if "uri" not in cfg.tracking:
        raise InputError("A report reads what was tracked: it needs tracking=mlflow.")
    save_as = save_path(cfg.save_as)
    kept = _kept_text(save_as)
    reader = MlflowReader(cfg.tracking.uri, cfg.tracking.experiment_name)
    runs = _chosen(reader.runs(), cfg.sweeps)
    directory, trust = run_directory(), Trust.given()

    def write(partial: Path) -> None:
        text = sections(Source(reader, runs, lambda run_id: _load(reader, run_id, trust), partial))
        (partial / "report.md").write_text(f"# {TITLE}\n\n{text}", encoding="utf-8")

    files = all_or_none(directory, write)
    say(f"report  {directory / 'report.md'}")
    if save_as is not None:
        page, text = Path(f"{save_as}.md"), (directory / "report.md").read_text(encoding="utf-8").split("\n\n", 1)[1]
        folder = page.with_suffix("")
        folder.mkdir(parents=True, exist_ok=True)
        for picture in (file for file in files if file.suffix == ".png"):
            shutil.copy(picture, folder)
            text = text.replace(f"]({picture.name})", f"]({quote(folder.name)}/{picture.name})")
        page.write_text(f"{kept}{MARK}\n\n{text}", encoding="utf-8")
        say(f"        {page}")


def _kept_text(save_as: Path | None) -> str:
    """Text above the generated part of an existing page that is to be replaced.

    Raises:
        InputError: the page has no generated part.
    """
    from lmd.core.checks import InputError

    page = Path(f"{save_as}.md")
    if save_as is None or not page.exists():
        return f"# {TITLE}\n\n"
    text = page.read_text(encoding="utf-8")
    if MARK not in text:
        raise InputError(f"save_as: {str(page)!r} is not overwritten, for it lacks the line {MARK!r}.")
    return text.split(MARK)[0]


def _chosen(runs: "pd.DataFrame", sweeps: ListConfig | None) -> "pd.DataFrame":
    """Runs of `sweeps` and of their jobs; all runs by default.

    Raises:
        InputError: a sweep has no runs.
    """
    from lmd.core.checks import InputError

    from .operations.tracking import PARENT_TAG

    if sweeps is None:
        return runs
    if not isinstance(sweeps, ListConfig):
        raise InputError(f"sweeps must be a list of run ids, got {sweeps!r}.")
    parents = runs.reindex(columns=[f"tags.{PARENT_TAG}"]).iloc[:, 0]
    for sweep in sweeps:
        if sweep not in set(parents):
            raise InputError(f"sweeps: no run belongs to a sweep with the id {sweep!r}.")
    return runs[parents.isin(list(sweeps)) | runs.index.isin(list(sweeps))]


def _load(reader: "MlflowReader", run_id: str, trust: Trust) -> "tuple[Problem, Deployment]":
    """Problem and deployment of a run, from the files of the run."""
    import numpy as np

    from lmd.core.checks import InputError

    source = f"run {run_id}"
    found = read_yaml(reader.artifact(run_id, "config.yaml"), source)
    parts = trust.parts(found, f"{source}: config.yaml", (*GROUPS, "encoding"))
    landmarks = reader.artifact(run_id, "landmarks.csv")
    # The result replaces the start; it is `free` of checks, as the run accepted it.
    deployment = {"_target_": "lmd.formats.tag_maps.FileDeployment", "path": str(landmarks), "free": True}
    try:
        problem = build_problem(OmegaConf.create({**parts, "deployment": deployment, "seed": 0, "threads": None}))
    except OmegaConfBaseException as error:
        raise InputError(f"{source}: config.yaml: {str(error).splitlines()[0]}") from None
    return problem, problem.draw(np.random.default_rng(0))


main = Command("report", report, runner=alone)

if __name__ == "__main__":
    main()
