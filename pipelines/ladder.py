"""Searches for several numbers of landmarks of one size with one seed, and what they have found, kept on disk."""

import re
from collections.abc import Callable, Iterable, Mapping
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from omegaconf import DictConfig

from .app import flat_settings
from .building import budget_of, build_optimiser, build_problem
from .documents import read_document, write_document
from .operations.sweeps.names import digest
from .optimise import SAME_WHEN_RESUMED

if TYPE_CHECKING:
    from lmd.evaluation.tradeoff import Found
    from lmd.problem import Problem
    from lmd.scene.deployment import Deployment

NO_SHARE = re.compile("cost|predicted_error_.*|.*_(seconds|standard_error)")  # among the figures of a point
Content = TypeVar("Content")
ARRAYS = ("positions", "normals", "surfaces")


@dataclass(frozen=True)
class Ladder:
    """The points of one edge and one seed.

    Args:
        cfg: of the pipeline.
        edge: of the tags, metres; 0 for landmarks that are points.
        seed: of the searches.
    """

    cfg: DictConfig
    edge: float
    seed: int

    def point(self, count: int) -> DictConfig:
        """The configuration of a point, on one thread."""
        cfg = deepcopy(self.cfg)
        cfg.deployment.count, cfg.tag.edge = count, self.edge or None
        cfg.seed, cfg.threads = self.seed, 1
        return cfg

    def problem(self, count: int) -> "Problem":
        """The problem of a point.

        Raises:
            InputError: its parts do not fit together.
        """
        return build_problem(self.point(count), count="counts")

    def anew(self, count: int) -> "Found":
        """What a search finds that sets out from nothing."""
        from lmd.evaluation.tradeoff import ANEW

        return self._search(self.problem(count), ANEW)

    def improved(self, known: "Mapping[int, Found]", chosen: Iterable[int]) -> "dict[int, Found]":
        """See `lmd.evaluation.tradeoff.improved`."""
        from lmd.evaluation.tradeoff import improved

        return improved(known, chosen, self.problem, self._search)

    def figures(self, found: "Found") -> dict[str, float]:
        """All figures of what was found."""
        from lmd.evaluation.tradeoff import SAMPLE

        deployment = found.deployment
        score = partial(figures_of, self.problem(len(deployment)), deployment, self.seed)
        return self._kept(len(deployment), f"figures of {SAMPLE}", deployment, score, dict)

    def _search(self, problem: "Problem", way: str) -> "Found":
        """Climb from the start of a problem with a budget of its own."""
        from lmd.evaluation.tradeoff import Found
        from lmd.scene.deployment import Deployment
        from lmd.scene.deployment_sources import GivenDeployment

        cfg = self.point(problem.count)

        def climb() -> dict[str, Any]:
            result = build_optimiser(cfg, self.seed).run(problem, budget_of(cfg))
            arrays = {name: getattr(result.deployment, name).tolist() for name in ARRAYS}
            return {**arrays, "fitness": result.fitness}

        start = problem.start.deployment if isinstance(problem.start, GivenDeployment) else None

        def found(kept: dict[str, Any]) -> Found:
            deployment = Deployment(*(kept[name] for name in ARRAYS))
            return Found(problem.labelled(deployment), kept["fitness"], way)

        return self._kept(problem.count, way, start, climb, found)

    def _kept(
        self,
        count: int,
        what: str,
        given: "Deployment | None",
        compute: Callable[[], dict[str, Any]],
        content_of: Callable[[dict[str, Any]], Content],
    ) -> Content:
        """What was computed before from the same configuration and deployment by the same code, or is computed now."""
        from lmd.core.compiled import sources

        settings = flat_settings(self.point(count), *SAME_WHEN_RESUMED, "budget")
        arrays = None if given is None else [getattr(given, name).tolist() for name in ARRAYS]
        path = Path(self.cfg.kept) / f"{digest(settings, what, arrays, sources())}.json"
        found = read_document(path, content_of)
        if found is not None:
            return found
        computed = compute()
        path.parent.mkdir(parents=True, exist_ok=True)
        write_document(path, computed)
        return content_of(computed)


def figures_of(problem: "Problem", deployment: "Deployment", seed: int) -> dict[str, float]:
    """All figures of a deployment, on the grid and off it, where `seed` draws the sample."""
    from lmd.evaluation.accuracy import accuracy_metrics
    from lmd.evaluation.tradeoff import SAMPLE
    from lmd.evaluation.validation import validation_metrics

    figures = problem.metrics(deployment) | validation_metrics(problem, deployment, seed, SAMPLE)
    return figures | accuracy_metrics(problem, deployment, seed)


def shares_among(figures: Iterable[str]) -> list[str]:
    """The names of those figures that are fractions in [0, 1], of which more is better."""
    return [name for name in figures if not NO_SHARE.fullmatch(name)]
