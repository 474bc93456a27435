"""Search as a Hydra sweeper: a method of nevergrad proposes values, which are run as jobs of a sweep."""

import math
import sys
from pathlib import Path
from statistics import median
from typing import Any

from hydra._internal import core_plugins
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import IntervalSweep, Override
from hydra.core.plugins import Plugins
from hydra.plugins.launcher import Launcher
from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf
from typing_extensions import override

from .names import SEED

LOSS_OF_FAILURE = 1e3  # loss of a failed trial; the loss of other trials is minus their figure, a fraction
DIGITS = 4  # significant digits of a proposed number


class Search(Sweeper):
    """Search for the largest value that jobs return, over the values that `params` and the command line vary.

    Values are ranges of Hydra: `interval(0.1,0.9)`, `int(interval(2,12))`, `tag(log,interval(0.001,0.1))`,
    `range(2,13)`, or a choice `pool,survivor`. Every trial runs all values of the seed; the value of the trial is the
    median over the seeds. A trial with a failed job is worse than all others. Proposals depend only on the method's
    seed and on earlier results, so an equal command finds its finished jobs again, and a command with more `trials`
    continues the search.

    Args:
        params: overrides of the stored search; overrides of the command line have precedence.
        trials: number of proposals.
        at_a_time: number of trials that are proposed before the first result.
        method: registered optimiser of nevergrad that needs no budget.
        seed: seed of the method.
    """

    def __init__(
        self, params: dict[str, Any], trials: int = 60, at_a_time: int = 2, method: str = "OnePlusOne", seed: int = 0
    ) -> None:
        self.params, self.trials, self.at_a_time, self.method, self.seed = params, trials, at_a_time, method, seed
        self.hydra_context: HydraContext | None = None
        self.launcher: Launcher | None = None
        self.config: DictConfig | None = None

    @override
    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        self.hydra_context, self.config = hydra_context, config
        self.launcher = Plugins.instance().instantiate_launcher(
            hydra_context=hydra_context, task_function=task_function, config=config
        )

    @override
    def sweep(self, arguments: list[str]) -> None:
        from lmd.core.checks import InputError

        try:
            self._search(arguments)
        except InputError as error:
            print(f"error: hydra.sweeper: {error}", file=sys.stderr)
            sys.exit(1)

    def _search(self, arguments: list[str]) -> None:
        from lmd.core.checks import integer

        context, config, launcher = self.hydra_context, self.config, self.launcher
        assert context is not None
        assert config is not None
        assert launcher is not None, "it was set up"
        trials, at_a_time = (integer(name, getattr(self, name), low=1) for name in ("trials", "at_a_time"))
        parser = OverridesParser.create(config_loader=context.config_loader)
        given = [f"{key}={value}" for key, value in self.params.items()] + arguments
        overrides = {override.get_key_element(): override for override in parser.parse_overrides(given)}
        seeds = _values(overrides.pop(SEED)) if SEED in overrides else ["0"]
        varied = {key: override for key, override in overrides.items() if override.is_sweep_override()}
        fixed = [f"{key}={o.get_value_element_as_str()}" for key, o in overrides.items() if key not in varied]
        method, jobs, best = self._method(varied), 0, (-math.inf, [""])
        OmegaConf.save(config, Path(config.hydra.sweep.dir, "multirun.yaml"))  # as Hydra's own sweeper does
        for first in range(0, trials, at_a_time):
            asked = [method.ask() for _ in range(min(at_a_time, trials - first))]
            proposed = [[f"{key}={_text(value)}" for key, value in trial.value.items()] for trial in asked]
            batch = [[*fixed, *trial, f"{SEED}={seed}"] for trial in proposed for seed in seeds]
            values = [job.return_value for job in launcher.launch(batch, initial_job_idx=jobs)]
            jobs += len(batch)
            before = best[0]
            for i, trial in enumerate(asked):
                found = [value for value in values[i * len(seeds) : (i + 1) * len(seeds)] if value is not None]
                whole = len(found) == len(seeds) and not any(map(math.isnan, found))
                method.tell(trial, -median(found) if whole else LOSS_OF_FAILURE)
                if whole and median(found) > best[0]:
                    best = median(found), proposed[i]
            if best[0] > before:
                print(f"best of {first + len(asked)} trials: {best[0]:.2%} with {' '.join(best[1])}", flush=True)

    def _method(self, varied: dict[str, Override]) -> Any:
        """Make the method that proposes values of the varied keys."""
        from lmd.core.checks import InputError, choice
        from lmd.core.optional import optional

        if not varied:
            raise InputError("a search needs keys that vary, such as optimiser.population=int(interval(6,60)).")
        nevergrad = optional("nevergrad", "optimisers")
        import numpy as np

        method = choice("method", self.method, sorted(nevergrad.optimizers.registry))
        space = nevergrad.p.Dict(**{key: _space(override) for key, override in varied.items()})
        space.random_state = np.random.RandomState(self.seed)  # nevergrad accepts no newer generator
        return nevergrad.optimizers.registry[method](space, budget=None, num_workers=self.at_a_time)


def _space(override: Override) -> Any:
    """Parameter of nevergrad for the values of a varied key."""
    import nevergrad

    values = override.value()
    if not isinstance(values, IntervalSweep):
        found = _values(override)
        return nevergrad.p.TransitionChoice(found) if override.is_range_sweep() else nevergrad.p.Choice(found)
    kind = nevergrad.p.Log if "log" in values.tags else nevergrad.p.Scalar
    space = kind(lower=values.start, upper=values.end)
    return space.set_integer_casting() if isinstance(values.start, int) else space


def _values(override: Override) -> list[str]:
    if not override.is_sweep_override():
        return [override.get_value_element_as_str()]
    return list(override.sweep_string_iterator())


def _text(value: Any) -> str:
    return f"{value:.{DIGITS}g}" if isinstance(value, float) else str(value)


# Hydra accepts sweepers only from its own modules and from installed plugins.
Search.__module__ = f"{core_plugins.__name__}.search"
setattr(core_plugins, "search", sys.modules[__name__])  # noqa: B010
Plugins.instance().register(Search)
