"""Points of a trade-off between the number and the size of landmarks.

A point is a number of landmarks, an edge length and a seed. The searches at the points run in parallel, and their
results are stored on disk. A `Ladder` is the series of points with one edge length and one seed, in which only the
number of landmarks varies.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from lmd.core.workers import in_processes

from .app import flat_settings, say
from .building import budget_of, build_optimiser, build_problem
from .composing import editable
from .optimise import SAME_WHEN_RESUMED
from .provenance import Computed, kept

if TYPE_CHECKING:
    import pandas as pd

    from lmd.evaluation.tradeoff import Found
    from lmd.problem import Problem
    from lmd.scene.deployment import Deployment


NO_SHARE = re.compile("cost|predicted_error_.*|.*_(seconds|standard_error)")  # figures that are not fractions
ARRAYS = ("positions", "normals", "surfaces")  # arrays of a deployment that are stored


@dataclass(frozen=True)
class Ladder:
    """Series of points of a trade-off with one edge length and one seed, for different numbers of landmarks."""

    cfg: DictConfig
    """Configuration of the pipeline."""
    edge: float
    """Edge length of all tags, metres; 0 for landmarks that are points."""
    seed: int
    """Seed of the searches."""

    def point(self, count: int) -> DictConfig:
        """Configuration of the point with `count` landmarks, on one thread."""
        cfg = editable(self.cfg)
        cfg.seed, cfg.threads, cfg.deployment.count, cfg.tag.edge = self.seed, 1, count, self.edge or None
        return cfg

    def problem(self, count: int) -> "Problem":
        """Build the problem of the point with `count` landmarks.

        Raises:
            InputError: the parts of the problem do not fit together.
        """
        return build_problem(self.point(count), "counts")

    def anew(self, count: int) -> "Found":
        """Result of a search that places `count` landmarks, and begins from the configured start."""
        from lmd.evaluation.tradeoff import ANEW

        return self._search(count, self.problem(count), ANEW)

    def improved(self, known: "Mapping[int, Found]", chosen: Iterable[int]) -> "dict[int, Found]":
        """Search again from the results for neighbouring numbers of landmarks (`lmd.evaluation.tradeoff.improved`).

        Args:
            known: results of earlier searches, by the number of landmarks.
            chosen: numbers of landmarks for which new searches are done.

        Returns:
            best result, of the earlier and the new searches, for each number in `chosen`.
        """
        from lmd.evaluation.tradeoff import improved

        return improved(known, chosen, self.problem, self._search)

    def figures(self, count: int, found: "Found") -> dict[str, float]:
        """Metrics of the deployment in `found`, which has `count` landmarks, see `figures_of`."""
        from lmd.evaluation.tradeoff import SAMPLE

        score = partial(figures_of, self.problem(count), found.deployment, self.seed)
        return self._kept(count, f"figures of {SAMPLE}", found.deployment, score)  # type: ignore[no-any-return]

    def _search(self, count: int, problem: "Problem", way: str) -> "Found":
        """Result of a search from the start of `problem`, with the budget of one point of the trade-off.

        Args:
            count: number of landmarks.
            problem: problem with the start of the search.
            way: name of the kind of start, such as `anew`; the result contains this name.
        """
        from lmd.evaluation.tradeoff import Found
        from lmd.scene.deployment import Deployment
        from lmd.scene.deployment_sources import GivenDeployment

        def climb() -> dict[str, Any]:
            result = build_optimiser(self.point(count), self.seed).run(problem, budget_of(self.cfg))
            return {**{name: getattr(result.deployment, name).tolist() for name in ARRAYS}, "fitness": result.fitness}

        def found(document: dict[str, Any]) -> Found:
            deployment = Deployment(*(document[name] for name in ARRAYS))
            return Found(problem.labelled(deployment), document["fitness"], way)

        start = problem.start.deployment if isinstance(problem.start, GivenDeployment) else None
        return self._kept(count, way, start, climb, found)  # type: ignore[no-any-return]

    def _kept(
        self, count: int, what: str, given: "Deployment | None", compute: Computed, read: Callable[[Any], Any] = dict
    ) -> Any:
        """Result for the point with `count` landmarks, read from disk, or computed and stored if it is not yet there.

        Args:
            count: number of landmarks.
            what: kind of the result.
            given: deployment from which the result is computed; None without a deployment.
            compute: function that computes the result as a document.
            read: function that converts the document to the result.
        """
        settings = flat_settings(self.point(count), *SAME_WHEN_RESUMED, "budget")
        arrays = None if given is None else [getattr(given, name).tolist() for name in ARRAYS]
        return kept(str(self.cfg.kept), (settings, what, arrays), compute, read)


def figures_of(problem: "Problem", deployment: "Deployment", seed: int) -> dict[str, float]:
    """Metrics of a deployment at the room's grid positions and at random poses, and metrics of accuracy.

    The random poses are drawn with `seed`. Accuracy is that with which single images localise the camera.
    """
    from lmd.evaluation.accuracy import accuracy_metrics
    from lmd.evaluation.tradeoff import SAMPLE
    from lmd.evaluation.validation import validation_metrics

    figures = problem.metrics(deployment) | validation_metrics(problem, deployment, seed, SAMPLE)
    return figures | accuracy_metrics(problem, deployment, seed)


def shares_among(figures: Iterable[str]) -> list[str]:
    """Names of the metrics that are fractions in [0, 1] to be maximised."""
    return [name for name in figures if not NO_SHARE.fullmatch(name)]


class Points:
    """Results at all points of a trade-off.

    A point is given by the index of its `Ladder` and its number of landmarks.

    Args:
        ladders: one `Ladder` for each pair of an edge length and a seed.
        workers: number of processes; None for every processor.
    """

    def __init__(self, ladders: Sequence[Ladder], workers: int | None) -> None:
        self.ladders, self._workers = ladders, workers
        self._found: list[dict[int, Found]] = [{} for _ in ladders]
        self._figures: dict[tuple[int, int], dict[str, float]] = {}

    def look(self, chosen: Sequence[tuple[int, int]]) -> None:
        """Search at the chosen points, evaluate the best result of each point, and add these points to the results.

        At each point, the first search begins from the configured start. Further searches begin from the results of
        neighbouring points.

        Args:
            chosen: points, each the index of a `Ladder` and a number of landmarks.
        """
        anew = {(n, count): partial(self.ladders[n].anew, count) for n, count in chosen}
        for (n, count), found in self._done("searched anew", anew):
            self._found[n][count] = found
        counts = {n: tuple(count for ladder, count in chosen if ladder == n) for n, _ in chosen}
        improved = {(n, *some): partial(self.ladders[n].improved, self._found[n], some) for n, some in counts.items()}
        for (n, *_), better in self._done("searched from neighbours", improved):
            self._found[n] |= better
        scored = {(n, count): partial(self.ladders[n].figures, count, self._found[n][count]) for n, count in chosen}
        self._figures |= dict(self._done("scored", scored))

    def _done(self, what: str, jobs: Mapping[Any, Callable[[], Any]]) -> Iterator[tuple[Any, Any]]:
        """Do jobs in several processes; yield the key and the result of each job, in the order of completion.

        Args:
            what: word for a job that is done, for messages, such as `scored`.
            jobs: functions to call; the key of each is the index of a `Ladder`, followed by one or more numbers of
                landmarks.
        """
        results = in_processes(_do, list(jobs.items()), self._workers, lambda job: self.name(*job[0]))
        for i, (key, result) in enumerate(results, 1):
            say(f"{i}/{len(jobs)} {what}: {self.name(*key)}")
            yield key, result

    def name(self, number: int, *counts: int) -> str:
        """Name of one point, or of several points of one `Ladder`, for messages.

        Args:
            number: index of the `Ladder`.
            counts: numbers of landmarks.
        """
        ladder, size = self.ladders[number], f" edge={self.ladders[number].edge}" if self.ladders[number].edge else ""
        return f"K={','.join(map(str, counts))}{size} seed={ladder.seed}"

    def __iter__(self) -> "Iterator[tuple[Ladder, int, str, Found, dict[str, float]]]":
        """Iterate over the points.

        Each item has the `Ladder`, the number of landmarks, the name of the point, the result of the search, and its
        metrics.
        """
        for n, count in sorted(self._figures):
            yield self.ladders[n], count, self.name(n, count), self._found[n][count], self._figures[n, count]

    @property
    def table(self) -> "pd.DataFrame":
        """Table with a row for each point, and the columns `edge`, `count`, `seed`, `way` and one for each metric.

        `way` names the kind of start from which the best result was found.
        """
        import pandas as pd

        return pd.DataFrame([
            {"edge": ladder.edge, "count": count, "seed": ladder.seed, "way": found.way, **figures}
            for ladder, count, _, found, figures in self
        ])  # fmt: skip


def _do(job: tuple[Any, Callable[[], Any]]) -> tuple[Any, Any]:
    """Do a job; return the job's key and result."""
    return job[0], job[1]()
