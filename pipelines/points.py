"""The points of a trade-off: what is found at each, and how its searches share the processors."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, TypeVar

from .building import instantiate
from .ladder import BUDGET, Ladder
from .workers import in_processes

if TYPE_CHECKING:
    import pandas as pd

    from lmd.evaluation.tradeoff import Axis, Found
    from lmd.scene.tag import Tag

Place = tuple[int, *tuple[float, ...]]  # the number of a ladder, and one or more places along it
Key = TypeVar("Key", bound=Place)
Result = TypeVar("Result")


class Points:
    """What is known of all points: pairs of the number of a ladder and where they are along it.

    Args:
        ladders: of every curve and seed.
        workers: processes; None for every processor.
    """

    def __init__(self, ladders: Sequence[Ladder], workers: int | None) -> None:
        self.ladders, self._workers, self.limited = ladders, workers, ladders[0].limited
        self._found: list[dict[float, Found]] = [{} for _ in ladders]
        self._figures: dict[tuple[int, float], dict[str, float]] = {}

    def look(self, chosen: Sequence[tuple[int, float]]) -> None:
        """Search at points anew and from their neighbours, and score the best that is found at each."""
        anew = {(n, at): partial(self.ladders[n].anew, at) for n, at in chosen}
        for (n, at), found in self._done("searched anew", anew):
            self._found[n][at] = found
        places = {n: tuple(at for ladder, at in chosen if ladder == n) for n, _ in chosen}
        improved: dict[Place, Callable[[], dict[float, Found]]]
        improved = {(n, *some): partial(self.ladders[n].improved, self._found[n], some) for n, some in places.items()}
        for (n, *_), better in self._done("searched from neighbours", improved):
            self._found[n] |= better
        for n, at in chosen:
            self._found[n][at] = self._best(n, at)
        scored = {(n, at): partial(self.ladders[n].figures, at, self._found[n][at]) for n, at in chosen}
        for point, figures in self._done("scored", scored):
            self._figures[point] = figures

    def _best(self, number: int, at: float) -> "Found":
        """What was found at a point, or if sizes may be mixed there what was found for one of them, if it is better."""
        from lmd.evaluation.tradeoff import ALONE

        own, best = self.ladders[number], self._found[number][at]
        for other, found in zip(self.ladders, self._found, strict=True):
            alone = other.seed == own.seed and other.edges != own.edges and len(own.edges) > 1
            if alone and at in found and found[at].fitness > best.fitness:
                best = replace(found[at], way=ALONE)
        return best

    def _done(self, what: str, jobs: Mapping[Key, Callable[[], Result]]) -> Iterator[tuple[Key, Result]]:
        """The keys of jobs and what they return, as they come."""
        results = in_processes(_do, list(jobs.items()), self._workers, lambda job: self.name(*job[0]))
        for i, (key, result) in enumerate(results, 1):
            print(f"{i}/{len(jobs)} {what}: {self.name(*key)}", flush=True)
            yield key, result

    def name(self, number: int, *places: float) -> str:
        """What a point, or several of one ladder, are called."""
        ladder, listed = self.ladders[number], ",".join(f"{at:.10g}" for at in places)
        size = [f"{self.axis.curve}={ladder.curve}"] if ladder.edges[0] else []
        return " ".join([f"{self.limited or 'K'}={listed}", *size, f"seed={ladder.seed}"])

    def of(self, curve: float | str) -> list[int]:
        """The numbers of the ladders of a curve."""
        return [n for n, ladder in enumerate(self.ladders) if ladder.curve == curve]

    @cached_property
    def axis(self) -> "Axis":
        """What the points lie along."""
        from lmd.evaluation.tradeoff import COUNTS, Axis

        if self.limited is None:
            return COUNTS
        tag: Tag = instantiate(self.ladders[0].cfg.tag, paper=None, budget=None, counts=None)
        costs = tag.costs if self.limited == BUDGET else None
        return Axis("edges", self.limited, min(costs or ((tag.paper_share * min(tag.sizes)) ** 2,)))

    def __iter__(self) -> "Iterator[tuple[int, float, Found, dict[str, float]]]":
        """For each point: which ladder it is on, where it is along it, what was found, and its figures."""
        for n, at in sorted(self._figures):
            yield n, at, self._found[n][at], self._figures[n, at]

    @property
    def table(self) -> "pd.DataFrame":
        """The curve and the point of `axis`, `seed`, `way` and the figures, a row for each point.

        Along limits also `count` and, for every edge, `count_<edge>`: how many landmarks have it.
        """
        import pandas as pd

        return pd.DataFrame([
            {
                self.axis.curve: self.ladders[n].curve, self.axis.along: at,
                "seed": self.ladders[n].seed, "way": found.way, **self.counts(found), **figures,
            }
            for n, at, found, figures in self
        ])  # fmt: skip

    def counts(self, found: "Found") -> dict[str, int]:
        """Along limits: how many landmarks there are, and of each edge."""
        edges = found.deployment.edges
        if self.limited is None or not found.deployment.has_own_edges:
            return {}
        from lmd.evaluation.tradeoff import COUNT_OF

        each = {f"{COUNT_OF}{edge:g}": int((edges == edge).sum()) for edge in sorted(self.ladders[0].edges)}
        return {"count": len(edges), **each}


def _do(job: tuple[Key, Callable[[], Result]]) -> tuple[Key, Result]:
    """The key of a job, and what it returns."""
    key, compute = job
    return key, compute()
