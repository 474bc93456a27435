"""How many landmarks, and how big: `python -m pipelines.tradeoff counts=[20,40,60] edges=[0.1,0.15] [overrides]`.

Jobs of a sweep know nothing of each other, but here each point sets out from its neighbours too. So this is one run,
whose searches share the processors, and which keeps what they have found.
"""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from math import isfinite
from typing import TYPE_CHECKING, Any, TypeVar

from omegaconf import DictConfig, OmegaConf

from .app import run_directory
from .building import budget_of, build_optimiser, instantiate, keyed, seeds_of
from .documents import write_document
from .earlier_run import read_earlier_problem
from .ladder import Ladder, figures_of, shares_among
from .operations.sweeps.names import slug
from .pipeline import Pipeline
from .workers import in_processes

if TYPE_CHECKING:
    import pandas as pd

    from lmd.evaluation.tradeoff import Found
    from lmd.problem import Problem

    from .operations.tracking import Tracker

Key = TypeVar("Key", bound=tuple[int, ...])
Result = TypeVar("Result")
COVERED, LOCALISED = "covered_share", "localised_share_20mm"  # off the grid, whatever the objective
LABELS = {
    COVERED: "share of views with n tags or more",
    LOCALISED: "share of views localised to 20 mm",
    "held_out_share": "share of the held-out time",
    "recorded_share": "share of the recorded time",
}


def tradeoff(cfg: DictConfig) -> None:
    """Search for every number of landmarks, edge and seed."""
    import numpy as np

    from lmd.core.checks import InputError, choice, file_path, real
    from lmd.evaluation.tradeoff import between
    from lmd.evaluation.validation import headline_off_grid
    from lmd.scene.deployment_sources import landmark_count

    from .tracked_run import title_of, tracked

    with keyed(count="counts"):
        counts = sorted({landmark_count(count) for count in _listed("counts", cfg.counts)})
    if cfg.tag.get("edges") is not None:
        raise InputError("tag.edges is for tags of several sizes; tradeoff compares single ones, given as edges=[...].")
    edges = [cfg.tag.edge or 0.0] if cfg.edges is None else _listed("edges", cfg.edges)
    edges = sorted({real("tag.edge" if cfg.edges is None else "edges", edge, low=0.0) for edge in edges})
    seeds = seeds_of(cfg)
    wanted = None if cfg.wanted is None else real("wanted", cfg.wanted, low=0.0, high=1.0)
    file_path("kept", cfg.kept)
    budget_of(cfg)
    optimiser = build_optimiser(cfg, seeds[0])  # what cannot be built fails before anything has run
    ladders = [Ladder(cfg, edge, seed) for edge, seed in product(edges, seeds)]
    for ladder, count in product(ladders[:: len(seeds)], (counts[0], counts[-1])):  # and what does not fit together
        problem = ladder.problem(count)
        problem.scene.check_one_size("a trade-off")
        optimiser.check(problem)
    if cfg.figure is not None:
        known = figures_of(problem, problem.draw(np.random.default_rng(seeds[0])), seeds[0])
        choice("figure", cfg.figure, shares_among(known))
    figure = cfg.figure or headline_off_grid(problem)
    points = Points(ladders, cfg.workers)
    with tracked(cfg, "tradeoff", title_of(problem, "tradeoff")) as tracker:
        try:
            points.look(list(product(range(len(ladders)), counts)))
            while wanted is not None and (halves := between(points.table, figure, wanted)):
                points.look([(number, count) for edge, count in halves for number in points.of(edge)])
        except KeyboardInterrupt:
            print(f"interrupted; the same command goes on with what is kept in {cfg.kept}", file=sys.stderr)
            raise
        _record(cfg, points, problem, figure, wanted, tracker)


def _listed(name: str, value: Any) -> list[Any]:
    from lmd.core.checks import InputError

    if not OmegaConf.is_list(value) or not len(value):
        raise InputError(f"{name} must be a list of numbers, got {value!r}.")
    return list(value)


class Points:
    """What is known of all points: pairs of the number of a ladder and a number of landmarks.

    Args:
        ladders: of every edge and seed.
        workers: processes; None for every processor.
    """

    def __init__(self, ladders: Sequence[Ladder], workers: int | None) -> None:
        self.ladders, self._workers = ladders, workers
        self._found: list[dict[int, Found]] = [{} for _ in ladders]
        self._figures: dict[tuple[int, int], dict[str, float]] = {}

    def look(self, chosen: Sequence[tuple[int, int]]) -> None:
        """Search at points anew and from their neighbours, and score the best that is found at each."""
        anew = {(n, count): partial(self.ladders[n].anew, count) for n, count in chosen}
        for (n, count), found in self._done("searched anew", anew):
            self._found[n][count] = found
        counts = {n: tuple(count for ladder, count in chosen if ladder == n) for n, _ in chosen}
        improved = {(n, *some): partial(self.ladders[n].improved, self._found[n], some) for n, some in counts.items()}
        for (n, *_), better in self._done("searched from neighbours", improved):
            self._found[n] |= better
        scored = {(n, count): partial(self.ladders[n].figures, self._found[n][count]) for n, count in chosen}
        for point, figures in self._done("scored", scored):
            self._figures[point] = figures

    def _done(self, what: str, jobs: Mapping[Key, Callable[[], Result]]) -> Iterator[tuple[Key, Result]]:
        """The keys of jobs and what they return, as they come."""
        results = in_processes(_do, list(jobs.items()), self._workers, lambda job: self.name(*job[0]))
        for i, (key, result) in enumerate(results, 1):
            print(f"{i}/{len(jobs)} {what}: {self.name(*key)}", flush=True)
            yield key, result

    def name(self, number: int, *counts: int) -> str:
        """What a point, or several of one ladder, are called."""
        ladder = self.ladders[number]
        size = [f"edge={ladder.edge:g}"] if ladder.edge else []
        return " ".join([f"K={','.join(map(str, counts))}", *size, f"seed={ladder.seed}"])

    def of(self, edge: float) -> list[int]:
        """The numbers of the ladders of an edge."""
        return [n for n, ladder in enumerate(self.ladders) if ladder.edge == edge]

    def __iter__(self) -> "Iterator[tuple[int, int, Found, dict[str, float]]]":
        """For each point: which ladder it is on, how many landmarks it has, what was found, and its figures."""
        for n, count in sorted(self._figures):
            yield n, count, self._found[n][count], self._figures[n, count]

    @property
    def table(self) -> "pd.DataFrame":
        """`edge,count,seed,way` and the figures, a row for each point; the edge is 0 for landmarks without a size."""
        import pandas as pd

        return pd.DataFrame([
            {"edge": self.ladders[n].edge, "count": count, "seed": self.ladders[n].seed, "way": found.way, **figures}
            for n, count, found, figures in self
        ])  # fmt: skip


def _do(job: tuple[Key, Callable[[], Result]]) -> tuple[Key, Result]:
    """The key of a job, and what it returns."""
    key, compute = job
    return key, compute()


def _record(
    cfg: DictConfig, points: Points, problem: "Problem", figure: str, wanted: float | None, tracker: "Tracker"
) -> None:
    """Write, log and show what is known."""
    from lmd.evaluation.tradeoff import fewest, front
    from lmd.evaluation.validation import headline_off_grid
    from lmd.objectives.localisation import Localisation
    from lmd.plot.tradeoff import Panel, save_tradeoff_figure

    from .tracked_run import keep

    directory, table, headline = run_directory(), points.table, problem.objective.headline
    off_grid, beside = headline_off_grid(problem), COVERED if isinstance(problem.objective, Localisation) else LOCALISED
    if problem.scene.recorded is None:
        panels = {off_grid: Panel(f"{headline.label}, off the grid", off_grid, headline.key)}
    else:  # a share of time, which has no counterpart on the grid
        panels = {off_grid: Panel(LABELS[off_grid], off_grid)}
    others = [name for name in (beside, figure) if name in table and name not in panels]
    panels |= {name: Panel(LABELS.get(name, name), name) for name in others}
    panels[figure] = panels[figure]._replace(wanted=wanted)
    curves = front(table, list(dict.fromkeys([figure, headline.key, *panels])))
    table.to_csv(directory / "points.csv", index=False)
    curves.to_csv(directory / "front.csv")
    save_tradeoff_figure(
        directory / "tradeoff.png", table, list(panels.values()), f"{problem.objective.name}, {cfg.seeds} seeds"
    )
    document: dict[str, Any] = {"figure": figure, "settings": problem.settings()}
    text = f"medians over {cfg.seeds} seeds, least and greatest of the first, per cent\n" + curves.to_string(
        float_format=lambda value: f"{100.0 * value:.2f}"
    )
    known: dict[str, float] = {}
    if wanted is not None:
        reached = fewest(table, figure, wanted)
        text += f"\n\nfewest landmarks with a {figure} of {wanted:g}\n{_told(reached)}"
        rows = reached.reset_index().to_dict("records")
        finite = [{key: value if isfinite(value) else None for key, value in row.items()} for row in rows]
        document |= {"wanted": wanted, "fewest": finite}
        known = {f"fewest/edge_{edge:g}": count for edge, count in reached["count"].items() if isfinite(count)}
    write_document(directory / "tradeoff.json", document)
    for name, edge in product(panels, dict.fromkeys(ladder.edge for ladder in points.ladders)):
        curve = [(int(count), float(value), 0.0) for count, value in curves.loc[edge, name].items()]
        tracker.log_curve(f"{name}/edge_{edge:g}", curve)
    _log_children(cfg, points, tracker.run_id)
    names = ("points.csv", "front.csv", "tradeoff.json", "tradeoff.png")
    keep(tracker, [directory / name for name in names], known)
    print(f"\n{text}\n\nfiles: {directory}\nmlflow: {tracker.describe()}")


def _told(reached: "pd.DataFrame") -> str:
    """`lmd.evaluation.tradeoff.fewest` for a terminal, a line for each edge."""
    lines = []
    for edge, *numbers in reached.reset_index().to_numpy().tolist():
        count, least, greatest = (f"{k:.0f}" if isfinite(k) else "more than was tried" for k in numbers)
        size = f"tags of {1e3 * edge:g} mm: " if edge else ""
        lines.append(f"{size}{count} by the median of the seeds, by single seeds {least} to {greatest}")
    return "\n".join(lines)


def _log_children(cfg: DictConfig, points: Points, parent: str | None) -> None:
    """Record a run for each point below the pipeline's own, its landmarks in a folder of the run."""
    from .operations.tracking import PARENT_TAG, RunStart

    for n, count, found, figures in points:
        ladder, name = points.ladders[n], points.name(n, count)
        landmarks = run_directory() / "points" / slug(name) / "landmarks.csv"
        landmarks.parent.mkdir(parents=True, exist_ok=True)  # a sweep may do a lost job again
        found.deployment.to_csv(landmarks, ups=bool(ladder.edge))
        tracker: Tracker = instantiate(cfg.tracking)
        tags = {"way": found.way} | ({} if parent is None else {PARENT_TAG: parent})
        params = {"deployment.count": count, "tag.edge": ladder.edge, "seed": ladder.seed}
        tracker.start(RunStart(name, landmarks.parent, params, tags))
        tracker.log_metrics(figures)
        tracker.log_artifacts([landmarks])
        tracker.finish("FINISHED")


main = Pipeline("tradeoff", tradeoff, (read_earlier_problem,))

if __name__ == "__main__":
    main()
