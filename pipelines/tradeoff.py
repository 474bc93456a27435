"""Trade off the objective against the number and size of landmarks.

The command is `python -m pipelines.tradeoff counts=[20,40,60] edges=[0.1,0.15] [overrides]`. The trade-off is one run
and not a sweep, because the search at each point also starts from the results of neighbouring points. Searches run in
parallel, and results are stored on disk.
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
from .points import Ladder, Points, figures_of, shares_among
from .study import LANDMARKS, Report, Study, log_child

if TYPE_CHECKING:
    import pandas as pd

    from lmd.problem import Problem

    from .operations.tracking import Tracker

COVERED, LOCALISED = "covered_share", "localised_share_20mm"  # figures off the grid, for every objective


def tradeoff(cfg: DictConfig) -> Study:
    """Return the study that searches at every combination of a number of landmarks, an edge length and a seed.

    If the key `size` is set, the study of the function `size` is returned instead.
    """
    if cfg.size:
        return size(cfg)
    import numpy as np

    from lmd.core.checks import InputError, choice, file_path, real
    from lmd.evaluation.tradeoff import between
    from lmd.evaluation.validation import headline_off_grid
    from lmd.objectives.base import selectable
    from lmd.scene.deployment_sources import landmark_count

    from .operations.tracking import RunStart

    with keyed(count="counts"):
        counts = sorted({landmark_count("count", count) for count in _listed("counts", cfg.counts)})
    if cfg.tag.get("edges") is not None:
        cure = "give edges=[...] for single sizes, or sweep over tag.paper or tag.budget with optimise"
        raise InputError(f"tag.edges is for mixtures of sizes: {cure}.")
    listed = [cfg.tag.edge or 0.0] if cfg.edges is None else _listed("edges", cfg.edges)
    edges = sorted({real("tag.edge" if cfg.edges is None else "edges", edge, low=0.0) for edge in listed})
    seeds = seeds_of(cfg)
    wanted = None if cfg.wanted is None else real("wanted", cfg.wanted, low=0.0, high=1.0)
    file_path("kept", cfg.kept)
    budget_of(cfg)
    optimiser = build_optimiser(cfg, seeds[0])  # built to check the settings before any search begins
    ladders = [Ladder(cfg, edge, seed) for edge, seed in product(edges, seeds)]
    for ladder, count in product(ladders[:: len(seeds)], (counts[0], counts[-1])):
        problem = ladder.problem(count)
        problem.scene.check_one_size("a trade-off of numbers of landmarks")
        optimiser.check(problem)
        selectable(problem.objective)  # deployments of one point grow from those of another point
    if cfg.figure is not None:
        known = figures_of(problem, problem.draw(np.random.default_rng(seeds[0])), seeds[0])
        choice("figure", cfg.figure, shares_among(known))
    figure = cfg.figure or headline_off_grid(problem)
    points = Points(ladders, cfg.workers)

    def run(tracker: "Tracker") -> Report:
        points.look(list(product(range(len(ladders)), counts)))
        while wanted is not None and (halves := dict(between(points.table, figure, wanted))):
            points.look([(n, halves[each.edge]) for n, each in enumerate(ladders) if each.edge in halves])
        for ladder, count, name, found, figures in points:  # children of this run
            folder = run_directory() / "points" / slug(name)
            folder.mkdir(parents=True, exist_ok=True)  # the folder exists if a sweep repeats a lost job
            found.deployment.to_csv(folder / LANDMARKS, ups=bool(ladder.edge))
            params = {"deployment.count": count, "seed": ladder.seed, "tag.edge": ladder.edge}
            started = RunStart(name, folder, params, {"way": found.way})
            log_child(cfg.tracking, started, tracker.run_id, figures)
        return _report(cfg, points.table, problem, figure, wanted)

    return Study("tradeoff", run, problem=problem, hint=partial(GOING_ON.format, cfg.kept))


def size(cfg: DictConfig) -> Study:
    """Return the study of the range of distances at which the camera detects each configured size of the tag."""
    from lmd.core.checks import InputError
    from lmd.evaluation.reach import Reading, reach_text
    from lmd.sight.models.fiducial import Fiducial
    from lmd.space.parts import made

    reading = made("size", {} if cfg.size is True else plain(cfg.size), Reading)
    (camera, *others), tag = camera_of(cfg.camera).cameras, instantiate(cfg.tag)
    criteria, _ = visibility_of(cfg.visibility)
    if others or not isinstance(criteria, Fiducial):
        lack = "one camera: leave camera.rig out" if others else "a detector: set visibility=fiducial"
        raise InputError(f"size needs {lack}.")
    tag.check_edge()
    with keyed("tag"):
        text = reach_text(camera, tag, criteria, reading)
    return Study("size", lambda _: Report({"size.txt": f"{text}\n"}, text=text))


def _listed(name: str, value: Any) -> list[Any]:
    from lmd.core.checks import InputError

    if not OmegaConf.is_list(value) or not len(value):
        raise InputError(f"{name} must be a list of numbers, got {value!r}.")
    return list(value)


def _report(cfg: DictConfig, table: "pd.DataFrame", problem: "Problem", figure: str, wanted: float | None) -> Report:
    """Report on the points in `table`: curves of the metrics against the number of landmarks.

    Unless `wanted` is None, the report also has the least number of landmarks for which the metric `figure` is at least
    `wanted`.
    """
    from lmd.evaluation.maps import percent_text
    from lmd.evaluation.tradeoff import fewest, front
    from lmd.evaluation.validation import headline_off_grid
    from lmd.objectives.base import figure_of
    from lmd.objectives.localisation import Localisation
    from lmd.plot.charts import Panel, save_tradeoff_figure

    headline, off_grid = problem.objective.headline, headline_off_grid(problem)
    beside = COVERED if isinstance(problem.objective, Localisation) else LOCALISED
    shown = dict.fromkeys([off_grid, *(name for name in (beside, figure) if name in table)])
    panels = {name: Panel(figure_of(name).label, name) for name in shown}
    if problem.scene.recorded is None:  # otherwise the grid cannot give the figure, a fraction of recorded time
        panels[off_grid] = Panel(f"{headline.label}, off the grid", off_grid, headline.key)
    panels[figure] = panels[figure]._replace(wanted=wanted)
    curves = front(table, list(dict.fromkeys([figure, headline.key, *panels])))
    title = f"{problem.objective.name}, {cfg.seeds} seeds"
    document: dict[str, Any] = {"figure": figure, "settings": problem.settings()}
    text = f"medians over {cfg.seeds} seeds, least and greatest of the first, per cent\n{percent_text(curves)}"
    known: dict[str, float] = {}
    if wanted is not None:
        reached = fewest(table, figure, wanted)
        text += f"\n\nfewest landmarks to reach {100.0 * wanted:g}% ({figure_of(figure).label})"
        text += f" by the median of the seeds, least and greatest of the seeds; inf: more than was tried\n{reached}"
        rows = reached.reset_index().to_dict("records")
        finite = [{key: None if value == inf else value for key, value in row.items()} for row in rows]
        document |= {"wanted": wanted, "fewest": finite}
        known = {f"fewest/edge_{edge:g}": count for edge, count in reached["count"].items() if isfinite(count)}
    lines = {
        f"{name}/edge_{edge:g}": [(int(at), value, 0.0) for at, value in same[["count", name]].to_numpy().tolist()]
        for name, (edge, same) in product(panels, curves.reset_index().groupby("edge"))
    }
    files = {
        "points.csv": table,
        "front.csv": curves.to_csv,
        "tradeoff.json": document,
        "tradeoff.png": lambda path: save_tradeoff_figure(path, table, list(panels.values()), title),
    }
    return Report(files, known, lines, f"\n{text}\n")


main = Command("tradeoff", tradeoff)

if __name__ == "__main__":
    main()
