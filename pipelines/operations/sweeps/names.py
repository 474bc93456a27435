"""Names of sweeps, of jobs, of their runs and of their folders."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf, read_write

from ...overrides import key_and_value, quoted
from ...provenance import digest
from .folder import SweepFolder

SLUG_LENGTH = 100  # greatest number of characters of a slug
NAME_LENGTH = 80  # greatest number of characters of a run's name; a longer name loses its beginning
DIGEST_LENGTH = 8  # characters of a digest in the name of a folder
# Keys that change neither the problem nor the search of a run.
NOT_IN_NAME = ("hydra", "tracking", "trust", "picture", "page", "validate", "threads", "resume", "checkpoint_seconds")


def override_tags(overrides: Sequence[str]) -> dict[str, str]:
    """Tags of a tracked run: all overrides in one tag, and each override in its own tag."""
    each = {f"override.{key}": value for key, value in map(key_and_value, overrides)}
    return {"overrides": " ".join(overrides)} | each


def short_name(subject: str, overrides: Sequence[str]) -> str:
    """Name of a run: the overrides that distinguish it, then its subject, as in `n=3 count=60 annealing`.

    Args:
        subject: subject of the run, in a word.
        overrides: overrides that vary.
    """
    values = [(key, value.strip("'\"")) for key, value in map(key_and_value, overrides)]
    shown = [
        f"{key.split('.')[-1]}={Path(value).name if '/' in value else value}"
        for key, value in values
        if key.split(".")[0] not in NOT_IN_NAME and value != subject
    ]
    return " ".join([*shown, subject])[-NAME_LENGTH:]


def slug(text: str) -> str:
    """Replace the characters of `text` that need quotes in a path or an override."""
    return re.sub(r"[^\w.-]+", "-", text)[:SLUG_LENGTH].strip("-.")


def _settings(root: DictConfig) -> Any:
    """Resolved configuration without Hydra's part."""
    return OmegaConf.to_container(
        OmegaConf.masked_copy(root, [str(key) for key in root if key != "hydra"]), resolve=True
    )


def swept(root: DictConfig) -> list[str]:
    """Overrides of a sweep: stored overrides, then overrides of the command line."""
    return [f"{key}={value}" for key, value in (root.hydra.sweeper.get("params") or {}).items()] + list(
        root.hydra.overrides.task
    )


def varied_keys(overrides: Sequence[str]) -> tuple[str, ...]:
    """Keys of the `overrides` that have more than one value."""
    from hydra.core.override_parser.overrides_parser import OverridesParser

    parsed = OverridesParser.create().parse_overrides(list(overrides))
    return tuple(dict.fromkeys(str(o.key_or_group) for o in parsed if o.is_sweep_override()))


def sweep_name(root: DictConfig) -> str:
    """Name of a sweep: its experiment or search, or else the varied keys."""
    stored = [root.hydra.runtime.choices.get(group) for group in ("experiment", "hparams_search")]
    return slug("_".join(filter(None, stored)) or "_".join(varied_keys(swept(root)))) or "sweep"


def sweep_folder(*, _root_: DictConfig) -> str:
    """Name of a sweep's folder: equal for equal varied keys and other settings, for any values of the varied keys."""
    varied = sorted(varied_keys(swept(_root_)))
    return f"{slug(sweep_name(_root_))}-{digest(_settings(_root_), varied)[:DIGEST_LENGTH]}"


def job_folder(*, _root_: DictConfig) -> str:
    """Name of a job's folder below the sweep's folder: equal for equal configurations and contents of files."""
    folder, known = SweepFolder(_root_.hydra.sweep.dir), digest(_settings(_root_))[:DIGEST_LENGTH]
    if (before := folder.job_of(known)) is not None:
        return before.name
    sweep = folder.load()
    values = [key_and_value(override) for override in _root_.hydra.overrides.task]
    kept = [f"{key.split('.')[-1]}-{value}" for key, value in values if sweep and key in sweep.varied]
    return "_".join([*filter(None, [slug("_".join(kept))]), known])


def pin_sweep_folder(config: DictConfig) -> Path:
    """Write the folder of a sweep to the configuration of its jobs, which cannot derive the folder, and return it."""
    folder = Path(config.hydra.sweep.dir)
    with read_write(config.hydra):
        config.hydra.sweep.dir = str(folder)
        config.hydra.overrides.hydra.append(f"hydra.sweep.dir={quoted(folder)}")  # jobs are composed from these
    return folder


OmegaConf.register_new_resolver("lmd.sweep_folder", sweep_folder, replace=True)
OmegaConf.register_new_resolver("lmd.job_folder", job_folder, replace=True)
