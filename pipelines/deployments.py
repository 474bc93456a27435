"""Several deployments in one run, for comparison."""

import re
import sys

from omegaconf import DictConfig, OmegaConf

from .earlier_run import OPTION, count_of, read_earlier_run
from .overrides import recompose, search_path, task_overrides

NAME = re.compile(r"[\w.-]+")  # characters that mlflow accepts in the name of a metric


def read_deployment_as_a_list() -> None:
    """Read `deployment=a,b,c` on the command line as `deployments=[a,b,c]`: one run compares them, without a sweep.

    An earlier run (`run=DIR`) is the deployment `run`, and the only deployment if no other is named. Its number of
    landmarks is the default for the other deployments.
    """
    sys.argv[1:] = [re.sub(r"^deployment=(.*)$", r"deployments=[\1]", argument) for argument in sys.argv[1:]]
    read_earlier_run(f"deployments=[{OPTION}]")


def composed_deployments(cfg: DictConfig, config_name: str) -> dict[str, DictConfig]:
    """Configuration for each entry of `deployments`, by the name of the entry.

    Args:
        config_name: name of the configuration, such as `observe`.

    Raises:
        InputError: there is no entry, or an entry is refused.
    """
    from lmd.core.checks import InputError

    entries = OmegaConf.to_container(cfg.deployments) if OmegaConf.is_list(cfg.deployments) else []
    if not entries or not all(str(entry).split() for entry in entries):
        raise InputError(f"deployments must list at least one option of conf/deployment, got {cfg.deployments!r}.")
    composed: dict[str, DictConfig] = {}
    count = [] if cfg.run is None else [f"deployment.count={count_of(str(cfg.run))}"]
    used: set[str] = set()
    for entry in map(str, entries):
        first, *rest = entry.split()
        name, option, own = (first[:-1], rest[0], rest[1:]) if first.endswith(":") and rest else (first, first, rest)
        if name in composed:
            raise InputError(f"deployments has {name!r} twice: give them names, e.g. 'mine: {entry}'.")
        if not NAME.fullmatch(name):
            raise InputError(f"deployments: the name {name!r} must be of letters, digits, _, - and dots.")
        composed[name] = _compose(config_name, entry, option, own, count, used)
    unused = [override for key, override in task_overrides() if key.startswith("deployment.") and key not in used]
    if unused:
        raise InputError(f"{unused[0]} is for none of the deployments {', '.join(composed)}.")
    return composed


def _compose(config_name: str, entry: str, option: str, own: list[str], count: list[str], used: set[str]) -> DictConfig:
    """Configuration for one deployment. Overrides of keys that the configuration lacks are dropped; the other keys are
    added to `used`.
    """
    keys = recompose(config_name, [*search_path(), f"deployment={option}"], "deployments", entry).deployment
    shared = count if "count" in keys and "path" not in keys else []
    for key, override in task_overrides():
        group, _, rest = key.partition(".")
        lacking = group == "deployment" and rest.split(".")[0] not in keys and not override.startswith("++")
        if group == "deployments" or lacking:
            continue
        used.add(key)
        shared = [*shared, override]
    return recompose(config_name, [*shared, *search_path(), f"deployment={option}", *own], "deployments", entry)


def any_deployment(cfg: DictConfig) -> DictConfig:
    """Configuration in which tags are points if the visibility model is for points.

    Overlapping papers are then not refused; pictures still show the papers.
    """
    return cfg if "tag" in cfg.visibility else OmegaConf.merge(cfg, {"tag": {"edge": None}})  # type: ignore[return-value]
