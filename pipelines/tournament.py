"""Compare optimisers over the suite: `python -m pipelines.compare suite=small optimisers=[annealing,ega] seeds=10`."""

from collections.abc import Iterator, Mapping
from itertools import product
from typing import TYPE_CHECKING

from omegaconf import DictConfig, OmegaConf

from .app import run_directory, save_path
from .building import GROUPS, build_optimiser, seeds_of
from .composing import recompose
from .contenders import Contender, contend
from .nodes import note
from .overrides import task_overrides
from .study import Report, Study

if TYPE_CHECKING:
    from lmd.evaluation.comparison import OptimiserRun
    from lmd.suite import BlackBox

CAMERAS = {"annealing": "camera_annealing"}  # optimiser of the same method for problems that place cameras
BUDGETS = ("1", "2", "3")  # places in the list of budgets of a problem


def tournament_of(cfg: DictConfig) -> Study:
    """Study of the optimisers of a configuration over problems of the suite, which writes the leaderboard.

    Raises:
        InputError: a setting is refused.
    """
    save_as, boxes = save_path(cfg.save_as), problems_of(cfg)
    about = f"{len(boxes)} problems, {len(cfg.optimisers)} optimisers, {cfg.seeds} seeds"
    names: list[str] = []

    def report(done: "Mapping[Contender, OptimiserRun]") -> Report:
        from lmd.plot.leaderboard import leaderboard, write_runs
        from lmd.suite import document

        budgets = {name: document(name).budgets for name in boxes}
        by_place: dict[int, list[OptimiserRun]] = {0: [], 1: [], 2: []}
        for job, run in done.items():
            by_place[list(budgets[job.problem]).index(job.evaluations)].append(run)
        write_runs(run_directory() / "iohprofiler", by_place, boxes)
        found = leaderboard(by_place, boxes)
        files = {**found.pictures, "leaderboard.md": found.text, "leaderboard.csv": found.table}
        names[:] = files
        return Report(files, found.figures, text=f"\n{found.text}")

    def saved() -> None:
        if save_as is None:
            return
        for name in names:
            save_as.with_name(f"{save_as.name}_{name}").write_bytes((run_directory() / name).read_bytes())

    return contend(cfg, list(_jobs(cfg, boxes)), report, saved, about=about)


def problems_of(cfg: DictConfig) -> "Mapping[str, BlackBox]":
    """The problems of `suite`: a set, a name or a list of names; those with several objectives are left out of a set.

    Raises:
        InputError: there is no such problem, or the configuration chooses parts of a problem besides.
    """
    from lmd.core.checks import InputError
    from lmd.suite import names, problem
    from lmd.suite.documents import SETS

    given = [key for key, _ in task_overrides() if key.split(".")[0].split("@")[0] in GROUPS]
    if given:
        raise InputError(f"suite = {cfg.suite} has frozen problems: leave {given[0]} out.", "suite")
    asked = OmegaConf.to_container(cfg.suite) if OmegaConf.is_config(cfg.suite) else cfg.suite
    listed = asked if isinstance(asked, list) else names(asked) if asked in SETS else [asked]
    boxes = {str(name): problem(str(name)) for name in listed}
    several = [name for name, box in boxes.items() if len(box.objectives) > 1]
    if several and asked not in SETS:
        raise InputError(f"suite: {several[0]} has several objectives; a comparison takes one.", "suite")
    return {name: box for name, box in boxes.items() if name not in several}


def _jobs(cfg: DictConfig, boxes: "Mapping[str, BlackBox]") -> Iterator[Contender]:
    """The runs, all problems with the first seed before any with the second.

    Raises:
        InputError: an optimiser is refused, or takes none of the problems.
    """
    from lmd.core.checks import InputError, choice
    from lmd.suite import document

    places = [BUDGETS.index(choice("suite_budgets", str(place), BUDGETS)) for place in cfg.suite_budgets]
    taken = {str(entry): _taken(str(entry), cfg, boxes) for entry in cfg.optimisers}
    if not taken or not places:
        raise InputError("optimisers and suite_budgets must name at least one.", "optimisers")
    for seed, place, name, entry in product(seeds_of(cfg), places, boxes, taken):
        if name in taken[entry]:
            yield Contender(entry, taken[entry][name], seed, name, document(name).budgets[place])


def _taken(entry: str, cfg: DictConfig, boxes: "Mapping[str, BlackBox]") -> dict[str, DictConfig]:
    """Configurations of an entry of `optimisers` for the problems that it takes."""
    from lmd.core.checks import InputError

    taken, refused = dict[str, DictConfig](), ""
    plain = _composed(entry, entry)
    for name, box in boxes.items():
        is_other = box.problem.genome is not None and entry in CAMERAS
        composed = _composed(entry, CAMERAS[entry]) if is_other else plain
        try:
            build_optimiser(composed, cfg.seed).check(box.problem)
        except InputError as error:
            refused = str(error)
            note(f"{entry} does not take {name}: {error}")
        else:
            taken[name] = composed
    if not taken:
        raise InputError(f"optimisers: {entry!r} takes none of the problems: {refused}", "optimisers")
    return taken


def _composed(entry: str, words: str) -> DictConfig:
    """The configuration of `optimise` with an optimiser and its own overrides."""
    name, *own = words.split()
    shared = [override for key, override in task_overrides() if key == "validate"]
    return recompose("optimise", [*shared, f"optimiser={name}", *own], "optimisers", entry)
