"""The values that a sweep varies, and the parameters that all its jobs share."""

from collections.abc import Mapping, Sequence
from typing import Any

from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from ...app import chosen
from ...provenance import parameters
from .names import SEED, swept

Values = dict[str, list[str]]


def asked_values(config: DictConfig) -> Values:
    """The values of each varied key, as overrides spell them; of an interval, which a search varies, its ends.

    Lets `glob` search the search path of the command line: Hydra composes with that path, but expands `glob` without
    it.

    Raises:
        InputError: a varied key has no value.
    """
    from hydra._internal.config_repository import ConfigRepository
    from hydra.core.global_hydra import GlobalHydra
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.core.override_parser.types import IntervalSweep

    from lmd.core.checks import InputError

    loader: Any = GlobalHydra.instance().config_loader()
    known = {entry.path for entry in loader.config_search_path.get_path()}
    for path in config.hydra.searchpath or ():
        if path not in known:
            loader.config_search_path.prepend("hydra.searchpath", path, "schema")
    loader.repository = ConfigRepository(loader.config_search_path)
    values: Values = {}
    for each in OverridesParser.create(config_loader=loader).parse_overrides(swept(config)):
        if not each.is_sweep_override():
            values.pop(each.get_key_element(), None)  # the last of two overrides of a key counts
            continue
        value = each.value()
        ends = [str(value.start), str(value.end)] if isinstance(value, IntervalSweep) else None
        found = list(each.sweep_string_iterator()) if ends is None else ends
        if not found:
            raise InputError(f"{each.input_line} has no values, so that there is nothing to run.")
        values[each.get_key_element()] = found
    return values


def parameters_of(composed: DictConfig) -> dict[str, Any]:
    """Parameters of a job, from its configuration with Hydra's part."""
    settings = OmegaConf.masked_copy(composed, [str(key) for key in composed if key != "hydra"])
    return parameters(settings, chosen(composed.hydra.runtime.choices))


def shared_parameters(config: DictConfig, values: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """The parameters that the jobs of a sweep share, as some jobs are composed: an option may change other groups.

    Composed are the first job, one for each further option of a varied group, and one for the last value of each other
    varied key.

    """
    from hydra.core.global_hydra import GlobalHydra
    from hydra.errors import HydraException

    loader = GlobalHydra.instance().config_loader()
    fixed = [override for override in swept(config) if override.partition("=")[0] not in values]
    first = {key: each[0] for key, each in values.items()}
    jobs = [first]
    for key, each in values.items():
        if key != SEED:
            others = each[1:] if loader.get_group_options(key.partition("@")[0]) else each[-1:]
            jobs += [first | {key: other} for other in others]
    every = []
    for job in jobs:
        overrides = [*config.hydra.overrides.hydra, *fixed, *(f"{key}={value}" for key, value in job.items())]
        try:
            composed = loader.load_configuration(config.hydra.job.config_name, overrides, RunMode.RUN)
        except (HydraException, ValueError):  # it is reported when the job begins
            continue
        every.append(parameters_of(composed))
    if not every:
        return {}
    return {
        key: value
        for key, value in every[0].items()
        if all(key in other and other[key] == value for other in every[1:])
        and not any(f"{key}.".startswith(f"{vary.lstrip('+')}.") for vary in values)
    }
