"""Trade number and size of landmarks: `python -m pipelines.tradeoff counts=[20,40,60] edges=[0.1,0.15] [overrides]`.

With a limit on paper or cost in place of counts: `python -m pipelines.tradeoff tag.edges=[0.06,0.1] papers=[0.2,0.4]
[overrides]`.

The trade-off is one run and not a sweep, as the search at each point also starts from the results of neighbouring
points. Searches run in parallel, and results are stored on disk.
"""

from functools import partial
from itertools import product
from math import inf, isfinite
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from .app import run_directory
from .building import budget_of, build_optimiser, camera_of, seeds_of, visibility_of
from .command import Command
from .contenders import GOING_ON
from .nodes import instantiate, keyed, plain
from .operations.sweeps.names import slug
from .points import BUDGET, PAPER, Ladder, Points, figures_of, shares_among
from .study import LANDMARKS, Report, Study, log_child

if TYPE_CHECKING:
    import pandas as pd

    from lmd.problem import Problem

    from .operations.tracking import Tracker

COVERED, LOCALISED = "covered_share", "localised_share_20mm"  # figures off the grid, for every objective
LIMITS = {PAPER: "papers", BUDGET: "budgets"}  # keys that list values of a limit
MLFLOW_STEPS = 1e4  # steps of mlflow, which are whole numbers, per unit of a limit: square centimetres of paper


def tradeoff(cfg: DictConfig) -> Study:
    """Prepare searches for every number of landmarks, edge and seed, or for every limit, mixture of edges and seed.

    With `size`, the study of the tags' range takes the place of searches.
    """
    if cfg.size:
        return size(cfg)
    import numpy as np

    from lmd.core.checks import choice, file_path, real
    from lmd.evaluation.tradeoff import between
    from lmd.evaluation.validation import headline_off_grid
    from lmd.objectives.base import selectable

    limited, places, curves = _curves(cfg)
    seeds = seeds_of(cfg)
    wanted = None if cfg.wanted is None else real("wanted", cfg.wanted, low=0.0, high=1.0)
    file_path("kept", cfg.kept)
    budget_of(cfg)
    optimiser = build_optimiser(cfg, seeds[0])  # built to check the settings before any search begins
    ladders = [Ladder(cfg, edges, seed, limited) for edges, seed in product(curves, seeds)]
    for ladder, at in product(ladders[:: len(seeds)], (places[0], places[-1])):
        problem = ladder.problem(at)
        if limited is None:
            problem.scene.check_one_size("a trade-off of numbers of landmarks")
        optimiser.check(problem)
        selectable(problem.objective)  # deployments of one point grow from those of another point
    if cfg.figure is not None:
        known = figures_of(problem, problem.draw(np.random.default_rng(seeds[0])), seeds[0])
        choice("figure", cfg.figure, shares_among(known))
    figure = cfg.figure or headline_off_grid(problem)
    points = Points(ladders, cfg.workers)

    def run(tracker: "Tracker") -> Report:
        points.look(list(product(range(len(ladders)), places)))
        while wanted is not None and (halves := between(points.table, figure, wanted, points.axis)):
            points.look([(number, at) for curve, at in halves for number in points.of(curve)])
        _log_points(cfg.tracking, points, tracker.run_id)
        return _report(cfg, points, problem, figure, wanted)

    return Study("tradeoff", run, problem=problem, hint=partial(GOING_ON.format, cfg.kept))


def size(cfg: DictConfig) -> Study:
    """Study of the range at which each size of the configured tag is detected by the configured camera."""
    import math

    from lmd.core.checks import InputError
    from lmd.evaluation.reach import Reading, reach_text
    from lmd.export.paper import PAPERS, largest_whole
    from lmd.sight.models.fiducial import Fiducial
    from lmd.space.parts import made

    reading = made("size", {} if cfg.size is True else plain(cfg.size), Reading)
    (camera, *others), tag = camera_of(cfg.camera).cameras, instantiate(cfg.tag)
    criteria, _ = visibility_of(cfg.visibility)
    if others or not isinstance(criteria, Fiducial):
        lack = "one camera: leave camera.rig out" if others else "a detector: it needs visibility=fiducial"
        raise InputError(f"size needs {lack}.")
    tag.check_edge()
    papers = ((paper, largest_whole(tag.of_size(tag.sizes[0]), paper)) for paper in PAPERS)
    on_sheets = ", ".join(f"{math.floor(1e3 * edge) / 1e3:g} m ({paper})" for paper, edge in papers)
    with keyed("tag"):
        text = f"{reach_text(camera, tag, criteria, reading)}\n\nlargest {tag.square} on one sheet: {on_sheets}"
    return Study("size", lambda _: Report({"size.txt": f"{text}\n"}, text=text))


def _curves(cfg: DictConfig) -> "tuple[str | None, list[float], list[tuple[float, ...]]]":
    """Limit on tags of several sizes, or None; points along the limit, or counts; edges of each curve.

    Raises:
        InputError: the lists of the configuration are refused, or contradict each other.
    """
    from lmd.core.checks import InputError, real
    from lmd.scene.deployment_sources import landmark_count

    limits = {key: cfg[name] for key, name in LIMITS.items() if cfg[name] is not None}
    if not limits:
        with keyed(count="counts"):
            counts = sorted({landmark_count("count", count) for count in _listed("counts", cfg.counts)})
        if cfg.tag.get("edges") is not None:
            cure = "give papers=[...] or budgets=[...] in place of counts, or edges=[...] for single sizes"
            raise InputError(f"tag.edges is for mixtures of sizes: {cure}.")
        edges = [cfg.tag.edge or 0.0] if cfg.edges is None else _listed("edges", cfg.edges)
        single = sorted({real("tag.edge" if cfg.edges is None else "edges", edge, low=0.0) for edge in edges})
        return None, [*counts], [(edge,) for edge in single]
    (limited, listed), *more = limits.items()
    name = LIMITS[limited]
    if more or cfg.edges is not None:
        raise InputError(f"{name} must not be given with {'edges' if not more else LIMITS[more[0][0]]}.")
    if cfg.tag.get("edges") is None or (limited == BUDGET and cfg.tag.get("costs") is None):
        raise InputError(f"{name} needs tag.edges=[...]{' and tag.costs=[...]' if limited == BUDGET else ''}.")
    places = sorted({real(name, limit, above=0.0) for limit in _listed(name, listed)})
    mixed = tuple(instantiate(cfg.tag, paper=None, budget=None, counts=None).edges)
    return limited, places, [mixed, *((edge,) for edge in mixed if len(mixed) > 1)]


def _listed(name: str, value: Any) -> list[Any]:
    from lmd.core.checks import InputError

    if not OmegaConf.is_list(value) or not len(value):
        raise InputError(f"{name} must be a list of numbers, got {value!r}.")
    return list(value)


def _report(cfg: DictConfig, points: Points, problem: "Problem", figure: str, wanted: float | None) -> Report:
    """Report on the points."""
    from lmd.evaluation.maps import percent_text
    from lmd.evaluation.tradeoff import fewest, front, mixtures
    from lmd.evaluation.validation import headline_off_grid
    from lmd.objectives.base import figure_of
    from lmd.objectives.localisation import Localisation
    from lmd.plot.charts import Panel, save_tradeoff_figure

    table, axis, headline = points.table, points.axis, problem.objective.headline
    off_grid, beside = headline_off_grid(problem), COVERED if isinstance(problem.objective, Localisation) else LOCALISED
    shown = dict.fromkeys([off_grid, *(name for name in (beside, figure) if name in table)])
    panels = {name: Panel(figure_of(name).label, name) for name in shown}
    if problem.scene.recorded is None:  # otherwise the grid cannot give the figure, a fraction of recorded time
        panels[off_grid] = Panel(f"{headline.label}, off the grid", off_grid, headline.key)
    panels[figure] = panels[figure]._replace(wanted=wanted)
    curves = front(table, list(dict.fromkeys([figure, headline.key, *panels])), axis)
    if (mixed := mixtures(table, axis)) is not None:
        curves["tags"] = mixed
    title = f"{problem.objective.name}, {cfg.seeds} seeds"
    document: dict[str, Any] = {"figure": figure, "settings": problem.settings()}
    text = f"medians over {cfg.seeds} seeds, least and greatest of the first, per cent\n{percent_text(curves)}"
    known: dict[str, float] = {}
    if wanted is not None:
        reached = fewest(table, figure, wanted, axis)
        least = "fewest landmarks" if points.limited is None else f"least {points.limited}"
        text += f"\n\n{least} to reach {100.0 * wanted:g}% ({figure_of(figure).label})\n{_told(reached)}"
        rows = reached.reset_index().to_dict("records")
        finite = [{key: None if value == inf else value for key, value in row.items()} for row in rows]
        document |= {"wanted": wanted, "fewest": finite}
        known = {f"fewest/{axis.curve}_{_slug(curve)}": at for curve, at in reached[axis.along].items() if isfinite(at)}
    scale = 1.0 if points.limited is None else MLFLOW_STEPS
    lines = {
        f"{name}/{axis.curve}_{_slug(curve)}": [
            (round(scale * at), value, 0.0) for at, value in same[[axis.along, name]].to_numpy().tolist()
        ]
        for name, (curve, same) in product(panels, curves.reset_index().groupby(axis.curve))
    }
    files = {
        "points.csv": table,
        "front.csv": curves.to_csv,
        "tradeoff.json": document,
        "tradeoff.png": lambda path: save_tradeoff_figure(path, table, list(panels.values()), title, axis),
    }
    return Report(files, known, lines, f"\n{text}\n")


def _slug(curve: Any) -> str:
    """Name of a curve for use in the name of a metric."""
    return f"{curve:g}" if isinstance(curve, float) else slug(curve)


def _told(reached: "pd.DataFrame") -> str:
    """Text about the result of `lmd.evaluation.tradeoff.fewest`, with a line for each curve."""
    from lmd.plot.charts import curve_name

    lines = []
    for curve, *numbers in reached.reset_index().to_numpy().tolist():
        count, least, greatest = (f"{k:.4g}" if isfinite(k) else "more than was tried" for k in numbers)
        size = f"{curve_name(curve)}: " if curve else ""
        lines.append(f"{size}{count} by the median of the seeds, by single seeds {least} to {greatest}")
    return "\n".join(lines)


def _log_points(tracking: DictConfig, points: Points, parent: str | None) -> None:
    """Record a run for each point as a child of the run `parent`, with the landmarks in a folder of the parent."""
    from .operations.tracking import RunStart

    for n, at, found, figures in points:
        ladder, name = points.ladders[n], points.name(n, at)
        folder = run_directory() / "points" / slug(name)
        folder.mkdir(parents=True, exist_ok=True)  # the folder exists if a sweep repeats a lost job
        found.deployment.to_csv(folder / LANDMARKS, ups=bool(ladder.edges[0]))
        params: dict[str, Any] = {"deployment.count": len(found.deployment), "seed": ladder.seed}
        several = {"tag.edges": list(ladder.edges), f"tag.{points.limited}": at, **points.counts(found)}
        params |= {"tag.edge": ladder.edges[0]} if points.limited is None else several
        log_child(tracking, RunStart(name, folder, params, {"way": found.way}), parent, figures)


main = Command("tradeoff", tradeoff)

if __name__ == "__main__":
    main()
