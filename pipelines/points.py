"""Points of a trade-off: parallel searches at points along curves; results are stored on disk."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from lmd.core.workers import in_processes

from .app import flat_settings, say
from .building import budget_of, build_optimiser, build_problem
from .composing import editable
from .nodes import instantiate
from .optimise import SAME_WHEN_RESUMED
from .provenance import Computed, kept

if TYPE_CHECKING:
    import pandas as pd

    from lmd.evaluation.tradeoff import Axis, Found
    from lmd.problem import Problem
    from lmd.scene.deployment import Deployment
    from lmd.scene.tag import Tag


NO_SHARE = re.compile("cost|predicted_error_.*|.*_(seconds|standard_error)")  # figures that are not fractions
ARRAYS = ("positions", "normals", "surfaces")  # arrays of a deployment that are stored
PAPER, BUDGET = "paper", "budget"  # keys of `tag` that limit tags of several sizes


@dataclass(frozen=True)
class Ladder:
    """Points along one curve for one seed."""

    cfg: DictConfig
    """Configuration of the pipeline."""
    edges: tuple[float, ...]
    """Edge of all tags, or the edges that are mixed, metres; 0 for landmarks that are points."""
    seed: int
    """Seed of the searches."""
    limited: str | None = None
    """Key of `tag` that varies along the curve, `PAPER` or `BUDGET`; None if the number of landmarks varies."""

    @property
    def curve(self) -> float | str:
        """Label of the curve: the edge, or the edges that are mixed."""
        from lmd.evaluation.tradeoff import MIXED

        return self.edges[0] if self.limited is None else MIXED.join(f"{edge:g}" for edge in self.edges)

    def point(self, at: float) -> DictConfig:
        """Configuration of the point with `at` landmarks, or with the limit `at`, on one thread."""
        cfg = editable(self.cfg)
        cfg.seed, cfg.threads = self.seed, 1
        if self.limited is None:
            cfg.deployment.count, cfg.tag.edge = at, self.edges[0] or None
            return cfg
        tag = cfg.tag
        tag.edge, tag.counts = tag.edge or max(tag.edges), None  # fixed tags keep their edge on every curve
        if self.limited == BUDGET:
            tag.costs = [cost for edge, cost in zip(tag.edges, tag.costs, strict=True) if edge in self.edges]
        tag.edges, tag.paper, tag.budget = list(self.edges), None, None
        tag[self.limited] = at
        return cfg

    def problem(self, at: float) -> "Problem":
        """Build the problem of a point.

        Raises:
            InputError: the parts of the problem do not fit together.
        """
        cfg = self.point(at)
        if self.limited is not None:
            any_seed, mixture = (
                replace(self, seed=self.cfg.seed),
                lambda: {"counts": build_problem(cfg).scene.tag.counts},
            )
            counts = any_seed._kept(at, "mixture", None, mixture, lambda known: [*map(int, known["counts"])])
            cfg.deployment.count = counts
        return build_problem(cfg, "deployment.count" if self.limited else "counts")

    def anew(self, at: float) -> "Found":
        """Result of a search from the configured start."""
        from lmd.evaluation.tradeoff import ANEW

        return self._search(at, self.problem(at), ANEW)

    def improved(self, known: "Mapping[float, Found]", chosen: Iterable[float]) -> "dict[float, Found]":
        """Results of searches that start from the results of neighbours, see `lmd.evaluation.tradeoff.improved`."""
        from lmd.evaluation.tradeoff import improved

        return improved(known, chosen, self.problem, self._search)

    def figures(self, at: float, found: "Found") -> dict[str, float]:
        """Figures of a result."""
        from lmd.evaluation.tradeoff import SAMPLE

        score = partial(figures_of, self.problem(at), found.deployment, self.seed)
        return self._kept(at, f"figures of {SAMPLE}", found.deployment, score)  # type: ignore[no-any-return]

    def _search(self, at: float, problem: "Problem", way: str) -> "Found":
        """Search from the start of a point's problem, with the budget for a point."""
        from lmd.evaluation.tradeoff import Found
        from lmd.scene.deployment import Deployment
        from lmd.scene.deployment_sources import GivenDeployment

        def climb() -> dict[str, Any]:
            cfg = self.point(at)
            result = build_optimiser(cfg, self.seed).run(problem, budget_of(cfg))
            return {**{name: getattr(result.deployment, name).tolist() for name in ARRAYS}, "fitness": result.fitness}

        def found(document: dict[str, Any]) -> Found:
            deployment = Deployment(*(document[name] for name in ARRAYS))
            return Found(problem.labelled(deployment), document["fitness"], way)

        start = problem.start.deployment if isinstance(problem.start, GivenDeployment) else None
        return self._kept(at, way, start, climb, found)  # type: ignore[no-any-return]

    def _kept(
        self, at: float, what: str, given: "Deployment | None", compute: Computed, read: Callable[[Any], Any] = dict
    ) -> Any:
        """Result of the kind `what` at a point, computed from a deployment or read from disk, see `kept`."""
        settings = flat_settings(self.point(at), *SAME_WHEN_RESUMED, "budget")
        arrays = None if given is None else [getattr(given, name).tolist() for name in ARRAYS]
        if arrays and given and given.has_own_edges:
            arrays.append(given.edges.tolist())
        return kept(str(self.cfg.kept), (settings, what, arrays), compute, read)


def figures_of(problem: "Problem", deployment: "Deployment", seed: int) -> dict[str, float]:
    """Figures of a deployment on the grid, and off the grid on a sample drawn with `seed`."""
    from lmd.evaluation.accuracy import accuracy_metrics
    from lmd.evaluation.tradeoff import SAMPLE
    from lmd.evaluation.validation import validation_metrics

    figures = problem.metrics(deployment) | validation_metrics(problem, deployment, seed, SAMPLE)
    return figures | accuracy_metrics(problem, deployment, seed)


def shares_among(figures: Iterable[str]) -> list[str]:
    """Names of the figures that are fractions in [0, 1] to be maximised."""
    return [name for name in figures if not NO_SHARE.fullmatch(name)]


class Points:
    """Results at all points. A point is given by the number of a ladder, and a place along its curve.

    Args:
        ladders: ladders of every curve and seed.
        workers: number of processes; None for every processor.
    """

    def __init__(self, ladders: Sequence[Ladder], workers: int | None) -> None:
        self.ladders, self._workers, self.limited = ladders, workers, ladders[0].limited
        self._found: list[dict[float, Found]] = [{} for _ in ladders]
        self._figures: dict[tuple[int, float], dict[str, float]] = {}

    def look(self, chosen: Sequence[tuple[int, float]]) -> None:
        """Search at points, from the configured start and from neighbours' results, and score the best result at each
        point.
        """
        anew = {(n, at): partial(self.ladders[n].anew, at) for n, at in chosen}
        for (n, at), found in self._done("searched anew", anew):
            self._found[n][at] = found
        places = {n: tuple(at for ladder, at in chosen if ladder == n) for n, _ in chosen}
        improved = {(n, *some): partial(self.ladders[n].improved, self._found[n], some) for n, some in places.items()}
        for (n, *_), better in self._done("searched from neighbours", improved):
            self._found[n] |= better
        for n, at in chosen:
            self._found[n][at] = self._best(n, at)
        scored = {(n, at): partial(self.ladders[n].figures, at, self._found[n][at]) for n, at in chosen}
        for point, figures in self._done("scored", scored):
            self._figures[point] = figures

    def _best(self, number: int, at: float) -> "Found":
        """Result at a point; for mixed sizes, the result of a single size if it is better."""
        from lmd.evaluation.tradeoff import ALONE

        own, best = self.ladders[number], self._found[number][at]
        for other, found in zip(self.ladders, self._found, strict=True):
            alone = other.seed == own.seed and other.edges != own.edges and len(own.edges) > 1
            if alone and at in found and found[at].fitness > best.fitness:
                best = replace(found[at], way=ALONE)
        return best

    def _done(self, what: str, jobs: Mapping[Any, Callable[[], Any]]) -> Iterator[tuple[Any, Any]]:
        """Do jobs in processes; yield keys, a ladder's number and places along it, with results in the order of
        completion.
        """
        results = in_processes(_do, list(jobs.items()), self._workers, lambda job: self.name(*job[0]))
        for i, (key, result) in enumerate(results, 1):
            say(f"{i}/{len(jobs)} {what}: {self.name(*key)}")
            yield key, result

    def name(self, number: int, *places: float) -> str:
        """Name of a point, or of several points of one ladder."""
        ladder, listed = self.ladders[number], ",".join(f"{at:.10g}" for at in places)
        size = [f"{self.axis.curve}={ladder.curve}"] if ladder.edges[0] else []
        return " ".join([f"{self.limited or 'K'}={listed}", *size, f"seed={ladder.seed}"])

    def of(self, curve: float | str) -> list[int]:
        """Numbers of the ladders of a curve."""
        return [n for n, ladder in enumerate(self.ladders) if ladder.curve == curve]

    @cached_property
    def axis(self) -> "Axis":
        """Quantity that varies along the curves, as an axis for tables and plots."""
        from lmd.evaluation.tradeoff import COUNTS, Axis

        if self.limited is None:
            return COUNTS
        tag: Tag = instantiate(self.ladders[0].cfg.tag, paper=None, budget=None, counts=None)
        costs = tag.costs if self.limited == BUDGET else None
        return Axis("edges", self.limited, min(costs or ((tag.paper_share * min(tag.sizes)) ** 2,)))

    def __iter__(self) -> "Iterator[tuple[int, float, Found, dict[str, float]]]":
        """Iterate over the points: number of the ladder, place along the curve, result, and figures."""
        for n, at in sorted(self._figures):
            yield n, at, self._found[n][at], self._figures[n, at]

    @property
    def table(self) -> "pd.DataFrame":
        """Table with a row for each point: curve, place along `axis`, `seed`, `way` and the figures.

        Points along limits also have `count` and, for every edge, the number of its landmarks, `count_<edge>`.
        """
        import pandas as pd

        def row(n: int, at: float, found: "Found", figures: dict[str, float]) -> dict[str, Any]:
            place = {self.axis.curve: self.ladders[n].curve, self.axis.along: at, "seed": self.ladders[n].seed}
            return {**place, "way": found.way, **self.counts(found), **figures}

        return pd.DataFrame([row(*point) for point in self])

    def counts(self, found: "Found") -> dict[str, int]:
        """Number of landmarks, in total and of each edge, for points along limits; otherwise empty."""
        edges = found.deployment.edges
        if self.limited is None or not found.deployment.has_own_edges:
            return {}
        from lmd.evaluation.tradeoff import COUNT_OF

        each = {f"{COUNT_OF}{edge:g}": int((edges == edge).sum()) for edge in sorted(self.ladders[0].edges)}
        return {"count": len(edges), **each}


def _do(job: tuple[Any, Callable[[], Any]]) -> tuple[Any, Any]:
    """Do a job; return the job's key and result."""
    return job[0], job[1]()
