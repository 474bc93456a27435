"""Searches along one curve of a trade-off with one seed, and what they have found, kept on disk."""

import re
from collections.abc import Callable, Iterable, Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
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
PAPER, BUDGET = "paper", "budget"  # keys of `tag` that limit tags of several sizes


@dataclass(frozen=True)
class Ladder:
    """The points of one curve and one seed.

    Args:
        cfg: of the pipeline.
        edges: the edge of all tags, metres, or those that are mixed; 0 for landmarks that are points.
        seed: of the searches.
        limited: which key of `tag` says where a point is along the curve, `PAPER` or `BUDGET`; None if the number of
            landmarks does.
    """

    cfg: DictConfig
    edges: tuple[float, ...]
    seed: int
    limited: str | None = None

    @property
    def curve(self) -> float | str:
        """What tells the curve from others: the edge, or those that may be mixed."""
        from lmd.evaluation.tradeoff import MIXED

        return self.edges[0] if self.limited is None else MIXED.join(f"{edge:g}" for edge in self.edges)

    def point(self, at: float) -> DictConfig:
        """The configuration of the point with so many landmarks, or with that limit, on one thread."""
        cfg = deepcopy(self.cfg)
        cfg.seed, cfg.threads = self.seed, 1
        if self.limited is None:
            cfg.deployment.count, cfg.tag.edge = at, self.edges[0] or None
            return cfg
        tag = cfg.tag
        tag.edge, tag.counts = tag.edge or max(tag.edges), None  # that of tags that hang already is that of all curves
        if self.limited == BUDGET:
            tag.costs = [cost for edge, cost in zip(tag.edges, tag.costs, strict=True) if edge in self.edges]
        tag.edges, tag.paper, tag.budget = list(self.edges), None, None
        tag[self.limited] = at
        return cfg

    def problem(self, at: float) -> "Problem":
        """The problem of a point.

        Raises:
            InputError: its parts do not fit together.
        """
        cfg = self.point(at)
        if self.limited is None:
            return build_problem(cfg, count="counts")

        def mixture() -> dict[str, Any]:
            return {"counts": build_problem(deepcopy(cfg)).scene.tag.counts}

        any_seed = replace(self, seed=self.cfg.seed)
        cfg.deployment.count = any_seed._kept(at, "mixture", None, mixture, lambda kept: list(map(int, kept["counts"])))
        return build_problem(cfg)

    def anew(self, at: float) -> "Found":
        """What a search finds that sets out from nothing."""
        from lmd.evaluation.tradeoff import ANEW

        return self._search(at, self.problem(at), ANEW)

    def improved(self, known: "Mapping[float, Found]", chosen: Iterable[float]) -> "dict[float, Found]":
        """See `lmd.evaluation.tradeoff.improved`."""
        from lmd.evaluation.tradeoff import improved

        return improved(known, chosen, self.problem, self._search)

    def figures(self, at: float, found: "Found") -> dict[str, float]:
        """All figures of what was found."""
        from lmd.evaluation.tradeoff import SAMPLE

        score = partial(figures_of, self.problem(at), found.deployment, self.seed)
        return self._kept(at, f"figures of {SAMPLE}", found.deployment, score, dict)

    def _search(self, at: float, problem: "Problem", way: str) -> "Found":
        """Climb from the start of the problem of a point with a budget of its own."""
        from lmd.evaluation.tradeoff import Found
        from lmd.scene.deployment import Deployment
        from lmd.scene.deployment_sources import GivenDeployment

        cfg = self.point(at)

        def climb() -> dict[str, Any]:
            result = build_optimiser(cfg, self.seed).run(problem, budget_of(cfg))
            arrays = {name: getattr(result.deployment, name).tolist() for name in ARRAYS}
            return {**arrays, "fitness": result.fitness}

        start = problem.start.deployment if isinstance(problem.start, GivenDeployment) else None

        def found(kept: dict[str, Any]) -> Found:
            deployment = Deployment(*(kept[name] for name in ARRAYS))
            return Found(problem.labelled(deployment), kept["fitness"], way)

        return self._kept(at, way, start, climb, found)

    def _kept(
        self,
        at: float,
        what: str,
        given: "Deployment | None",
        compute: Callable[[], dict[str, Any]],
        content_of: Callable[[dict[str, Any]], Content],
    ) -> Content:
        """What was computed before from the same configuration and deployment by the same code, or is computed now."""
        from lmd.core.sources import package_digest

        settings = flat_settings(self.point(at), *SAME_WHEN_RESUMED, "budget")
        arrays = None if given is None else [getattr(given, name).tolist() for name in ARRAYS]
        if arrays and given and given.has_own_edges:
            arrays.append(given.edges.tolist())
        path = Path(self.cfg.kept) / f"{digest(settings, what, arrays, package_digest())}.json"
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
