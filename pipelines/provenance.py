"""What a run was made with: its parameters, the command, the version, the commit."""

import getpass
import shlex
import subprocess
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from .app import CONF, IN_CHECKOUT, command_of, flat_settings
from .operations.sweeps.folder import current_job
from .operations.sweeps.names import at

# What a run is about is a parameter; what only says how it is done, where it goes on and where it is kept is none.
NO_PARAMETERS = (
    "tracking", "trust", "run", "resume", "picture", "page", "threads", "checkpoint_seconds", "tracked_as", "export",
    "paper_size", "north",
)  # fmt: skip


def command_line(pipeline: str, overrides: Sequence[str]) -> str:
    """A command of this project, for a shell."""
    return " ".join([command_of(pipeline), shlex.join(overrides)]).strip()


def resuming(pipeline: str, folder: Path) -> str:
    """The command that goes on with what this one has left in a folder."""
    given = [word for word in sys.argv[1:] if not word.startswith("resume=")]
    return command_line(pipeline, [*given, at("resume", folder)])


def source_tags(pipeline: str) -> dict[str, str]:
    """Tags of a run, most under the names by which mlflow shows them: who ran what, from which commit."""
    tags = {"mlflow.source.name": command_of(pipeline), "mlflow.source.type": "LOCAL", "mlflow.user": _user()}
    given = sys.argv[1:]
    if current_job() is not None:  # again by itself, it must not write into the folder of the sweep
        given = [word for word in given if not word.startswith(("hydra.run.dir=", "resume="))]
    return tags | {"command": command_line(pipeline, given)} | _version()


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a container may have no name for its user
        return "unknown"


@cache
def _version() -> dict[str, str]:
    try:
        tags = {"version": version("lmd")}
    except PackageNotFoundError:  # a checkout that is not installed
        tags = {}
    commit = _git("rev-parse", "HEAD") if IN_CHECKOUT else ""
    if commit:
        tags |= {"mlflow.source.git.commit": commit, "uncommitted changes": "yes" if _git("status", "-s") else "no"}
    return tags


def _git(*arguments: str) -> str:
    """What git prints in this checkout; nothing where there is no git, or no repository."""
    try:
        line = ["git", "--no-optional-locks", *arguments]  # a run may be killed, and would leave the lock behind
        done = subprocess.run(line, cwd=Path(CONF).parent, capture_output=True, text=True, timeout=5.0, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip()


def parameters(cfg: DictConfig, choices: Mapping[str, str]) -> dict[str, Any]:
    """The choices of groups, and the settings below them that are set to something."""
    settings = {
        key: value
        for key, value in flat_settings(cfg).items()
        if key.split(".")[0] not in NO_PARAMETERS
        and key.split(".")[-1] not in ("_target_", "_partial_")
        and value not in (None, [])
    }
    return {group: option for group, option in choices.items() if group not in NO_PARAMETERS} | settings
