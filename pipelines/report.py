"""Report that compares the stored sweeps with the paper: `python -m pipelines.report [tracking.uri=...]`."""

from pathlib import Path
from typing import TYPE_CHECKING

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from .app import run_directory, say
from .building import build_problem
from .command import Command
from .composing import GROUPS
from .outputs import all_or_none
from .trust import Trust, read_yaml

if TYPE_CHECKING:
    from lmd.problem import Problem
    from lmd.scene.deployment import Deployment

    from .operations.tracking import MlflowReader


def report(cfg: DictConfig) -> None:
    """Write report.md, with pictures, to the run directory.

    For each name of a sweep, the report describes the newest sweep of that name.
    """
    from lmd.core.checks import InputError

    from .operations.tracking import MlflowReader
    from .sections import sections
    from .stored_runs import Source

    if "uri" not in cfg.tracking:
        raise InputError("The report reads runs from mlflow: set tracking=mlflow.")
    reader = MlflowReader(cfg.tracking.uri, cfg.tracking.experiment_name)
    runs, trust = reader.runs(), Trust.of(cfg, HydraConfig.get().runtime)

    def write(partial: Path) -> None:
        text = sections(Source(reader, runs, lambda run_id: _load(reader, run_id, trust), partial))
        (partial / "report.md").write_text(f"# The paper's tables and figures, reproduced\n\n{text}", encoding="utf-8")

    all_or_none(run_directory(), write)
    say(f"report  {run_directory() / 'report.md'}")


def _load(reader: "MlflowReader", run_id: str, trust: Trust) -> "tuple[Problem, Deployment]":
    """Load the problem and the deployment of a run from the files that the run has stored; return both."""
    import numpy as np

    from lmd.core.checks import InputError

    source = f"run {run_id}"
    found = read_yaml(reader.artifact(run_id, "config.yaml"), source)
    parts = trust.parts(found, f"{source}: config.yaml", (*GROUPS, "encoding"))
    landmarks = str(reader.artifact(run_id, "landmarks.csv"))
    # The result replaces the start; the source is `free` of checks, as the run has accepted the result.
    deployment = {"_target_": "lmd.formats.tag_maps.FileDeployment", "path": landmarks, "free": True}
    try:
        problem = build_problem(OmegaConf.create({**parts, "deployment": deployment, "seed": 0, "threads": None}))
    except OmegaConfBaseException as error:
        raise InputError(f"{source}: config.yaml: {str(error).splitlines()[0]}") from None
    return problem, problem.draw(np.random.default_rng(0))


main = Command("report", report)

if __name__ == "__main__":
    main()
