"""Names of sweeps and jobs, used for their tracked runs and for their folders."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf, read_write

from ...app import changes_results, key_and_value, quoted, spelled
from ...provenance import digest
from .folder import SweepFolder

SLUG_LENGTH = 100  # maximum number of characters of a slug
NAME_LENGTH = 80  # maximum number of characters of a run's name; the list of varied keys is cut
SEED = "seed"  # jobs that differ only in this key form a group
SHORT = {"thold_p": "p"}  # abbreviations of keys in names
DIGEST_LENGTH = 8  # number of characters of a digest in a folder's name
NOT_IN_NAME = ("hydra", "validate")  # keys that change neither the problem nor the search of a run


def override_tags(overrides: Sequence[str]) -> dict[str, str]:
    """Labels of a tracked run (tags of mlflow) for its overrides: one for each override, and one for all together."""
    each = {f"override.{key}": value for key, value in map(key_and_value, overrides)}
    return {"overrides": " ".join(overrides)} | each


def short_name(subject: str, overrides: Sequence[str], given: Sequence[str] = ()) -> str:
    """Name of a run, such as `ega n=4 p=0.7 s1` or `n=4 ega room=hall`.

    Values that vary come first, because tables cut long names.

    Args:
        subject: subject of the run, one word.
        overrides: overrides whose values vary between runs.
        given: further overrides of the command line.
    """
    varies = in_name(overrides, subject)[: NAME_LENGTH - len(subject) - 1]
    is_first = any(value.strip("'\"") == subject for _, value in map(key_and_value, overrides))
    words = [subject, varies] if is_first else [varies, subject]
    return " ".join(filter(None, [*words, in_name(given, subject)]))[:NAME_LENGTH].rstrip()


def in_name(overrides: Sequence[str], *left_out: str) -> str:
    """Text of the overrides in the form used in names.

    This is `n=4` for `objective.n=4`, and `s1` for the seed 1. A path is shortened to the name of the file. Overrides
    that change no result, and overrides with one of the values `left_out`, are omitted.
    """
    words = []
    for key, text in map(key_and_value, overrides):
        value, name = text.strip("'\""), key.split(".")[-1]
        if key.split(".")[0] not in NOT_IN_NAME and changes_results(key) and value not in left_out:
            value = Path(value).name if "/" in value else value
            words.append(f"s{value}" if key == SEED else f"{SHORT.get(name, name)}={value}")
    return " ".join(words)


def slug(text: str) -> str:
    """Replace characters that would need quotes in a path or an override by hyphens, and cut a long text."""
    return re.sub(r"[^\w.-]+", "-", text)[:SLUG_LENGTH].strip("-.")


def _settings(root: DictConfig) -> Any:
    """Resolved configuration as plain data, without the node `hydra` and without keys that do not affect results."""
    task = OmegaConf.masked_copy(root, [str(key) for key in root if key != "hydra"])
    resolved: Any = OmegaConf.to_container(task, resolve=True)
    return {key: value for key, value in resolved.items() if changes_results(key)}


def swept(root: DictConfig) -> list[str]:
    """All overrides of a sweep.

    The overrides stored with the sweep's experiment come first, then the overrides of the command line.
    """
    stored = root.hydra.sweeper.get("params") or {}
    return [*(f"{key}={value}" for key, value in stored.items()), *root.hydra.overrides.task]


def varied_keys(overrides: Sequence[str]) -> tuple[str, ...]:
    """Config keys for which the `overrides` list more than one value."""
    from hydra.core.override_parser.overrides_parser import OverridesParser

    parsed = OverridesParser.create().parse_overrides(list(overrides))
    return tuple(dict.fromkeys(o.get_key_element().lstrip("+~") for o in parsed if o.is_sweep_override()))


def sweep_name(root: DictConfig) -> str:
    """Name of a sweep: the name of its experiment or, without an experiment, the varied keys."""
    stored = root.hydra.runtime.choices.get("experiment")
    return slug(stored or "_".join(varied_keys(swept(root)))) or "sweep"


def sweep_title(root: DictConfig) -> str:
    """Name of a sweep's tracked run, such as `n x thold_p x optimiser room=hall`.

    The varied keys come first, then the other overrides.
    """
    varied = varied_keys(swept(root))
    given = [o for o in root.hydra.overrides.task if key_and_value(o)[0] not in varied]
    keys = [key.split(".")[-1] for key in varied if key != SEED] or [SEED]
    return " ".join([" x ".join(keys), in_name(given)]).rstrip()


def sweep_folder(*, _root_: DictConfig) -> str:
    """Name of a sweep's folder.

    Two sweeps have equal names if they vary the same keys (over any values) and agree in all other settings that affect
    results.
    """
    varied = sorted(varied_keys(swept(_root_)))
    return f"{slug(sweep_name(_root_))}-{digest(_settings(_root_), varied)[:DIGEST_LENGTH]}"


def job_folder(*, _root_: DictConfig) -> str:
    """Name of a job's folder within the sweep's folder.

    Two jobs have equal names if they agree in all settings that affect results, and in the contents of the files that
    the settings name. The values of all varied keys, even of `threads`, must also agree.
    """
    folder = SweepFolder(_root_.hydra.sweep.dir)
    sweep, values = folder.load(), map(key_and_value, _root_.hydra.overrides.task)
    varied = [(key, value) for key, value in values if sweep and key in sweep.varied]
    without = [f"{key}={value}" for key, value in varied if not changes_results(key)]
    known = digest(_settings(_root_), *without)[:DIGEST_LENGTH]
    if (before := folder.job_of(known)) is not None:
        return before.name
    kept = [f"{key.split('.')[-1]}-{value}" for key, value in varied]
    return "_".join([*filter(None, [slug("_".join(kept))]), known])


def pin_sweep_folder(config: DictConfig) -> Path:
    """Return the path of the sweep's folder, and write this path into the configuration of the jobs.

    The jobs cannot compute the path themselves. Values with a plus sign are also quoted in the jobs' overrides, see
    `spelled`.
    """
    folder = Path(config.hydra.sweep.dir)
    with read_write(config.hydra):
        config.hydra.overrides.task = list(map(spelled, config.hydra.overrides.task))
        config.hydra.sweep.dir = str(folder)
        config.hydra.overrides.hydra.append(f"hydra.sweep.dir={quoted(folder)}")  # jobs are composed from these
    return folder


OmegaConf.register_new_resolver("lmd.sweep_folder", sweep_folder, replace=True)
OmegaConf.register_new_resolver("lmd.job_folder", job_folder, replace=True)
