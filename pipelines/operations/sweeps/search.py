"""Search as a Hydra sweeper: a method of nevergrad proposes values, which are run as jobs of a sweep."""

import math
import sys
from pathlib import Path
from statistics import fmean, median
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
SUITE = "suite"  # key of the frozen problem that a job solves
DIGITS = 4  # significant digits of a proposed number


class Search(Sweeper):
    """Search for the largest value that jobs return, over the values that `params` and the command line vary.

    Values are ranges of Hydra: `interval(0.1,0.9)`, `int(interval(2,12))`, `tag(log,interval(0.001,0.1))`,
    `range(2,13)`, or a choice `pool,survivor`. Every trial runs all values of the seed; the value of the trial is the
    median over the seeds. With several problems of the suite (`suite=A,B`) every trial runs all of them, and its value
    is the mean over the problems of this median as a fraction of the best value known. A trial with a failed job is
    worse than all others. Proposals depend only on the method's seed and on earlier results, so an equal command finds
    its finished jobs again, and a command with more `trials` continues the search.

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
            sys.exit(f"error: hydra.sweeper: {error}")

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
        several = SUITE in overrides and overrides[SUITE].is_sweep_override()
        problems = _scaled(_values(overrides.pop(SUITE)), config.returns) if several else [([], 1.0)]
        varied = {key: override for key, override in overrides.items() if override.is_sweep_override()}
        fixed = [f"{key}={o.get_value_element_as_str()}" for key, o in overrides.items() if key not in varied]
        method, jobs, best = self._method(varied), 0, (-math.inf, [""])
        OmegaConf.save(config, Path(config.hydra.sweep.dir, "multirun.yaml"))  # as Hydra's own sweeper does
        for first in range(0, trials, at_a_time):
            asked = [method.ask() for _ in range(min(at_a_time, trials - first))]
            proposed = [[f"{key}={_text(value)}" for key, value in trial.value.items()] for trial in asked]
            batch = [
                [*fixed, *problem, *trial, f"{SEED}={seed}"]
                for trial in proposed
                for problem, _ in problems
                for seed in seeds
            ]
            values = [job.return_value for job in launcher.launch(batch, initial_job_idx=jobs)]
            jobs += len(batch)
            before = best[0]
            for i, trial in enumerate(asked):
                found = [values.pop(0) for _ in range(len(problems) * len(seeds))]
                if any(value is None or math.isnan(value) for value in found):
                    method.tell(trial, LOSS_OF_FAILURE)
                    continue
                medians = [median(found[k : k + len(seeds)]) for k in range(0, len(found), len(seeds))]
                value = fmean(each / known for each, (_, known) in zip(medians, problems, strict=True))
                method.tell(trial, -value)
                if value > best[0]:
                    best = value, proposed[i]
            if best[0] > before:
                share = f"{best[0]:.2%}{' of the best values known' if several else ''}"
                print(f"best of {first + len(asked)} trials: {share} with {' '.join(best[1])}", flush=True)

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


def _scaled(names: list[str], returns: str) -> list[tuple[list[str], float]]:
    """Override that chooses each frozen problem, and the best value known of the figure that its jobs return.

    Raises:
        InputError: no value is known of a problem.
    """
    from lmd.core.checks import InputError
    from lmd.suite import document

    found: list[tuple[list[str], float]] = []
    for name in names:
        best = document(name).best
        known = None if best is None else best.value if returns == "fitness" else best.off_grid
        if not known:
            raise InputError(f"suite: no best value is known of {name!r}, so its values cannot be scaled.")
        found.append(([f"{SUITE}={name}"], known))
    return found


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
