"""Compare optimisers: `python -m pipelines.compare optimisers=[annealing,ega] seeds=10 [overrides]`.

With `suite=small` the optimisers are compared on the problems of the suite, and `leaderboard.md` ranks them.
"""

import re
from collections.abc import Callable, Mapping
from itertools import product
from typing import TYPE_CHECKING

from omegaconf import DictConfig, OmegaConf

from .app import changes_results, choices, flat_settings, run_directory, task_overrides
from .building import GROUPS, budget_of, build_optimiser, build_problem, seeds_of
from .command import Command
from .composing import editable, recompose
from .contenders import Contender, contend
from .nodes import note, plain
from .provenance import parameters
from .study import Report, Study, dataset_of, derived, log_child, title_of

if TYPE_CHECKING:
    from lmd.evaluation.comparison import OptimiserRun
    from lmd.suite import BlackBox

# Settings of the comparison itself; all other overrides are passed on to its runs.
OWN_KEYS = ("optimisers", "reference", "seeds", "budget", "seed")
CAMERAS = {"annealing": "camera_annealing"}  # for problems that place cameras: optimiser that uses the same method
BUDGETS = ("1", "2", "3")  # positions in the list of budgets of a suite problem


def compare(cfg: DictConfig) -> Study:
    """Return the study that compares the configured optimisers, on one problem or on problems of the suite."""
    from lmd.core.checks import InputError

    entries = cfg.optimisers
    if not OmegaConf.is_list(entries) or not entries or not all(str(entry).split() for entry in entries):
        raise InputError(f"optimisers must list at least one name, got {entries!r}.")
    return _on_one_problem(cfg) if cfg.suite is None else _over_suite(cfg)


def _on_one_problem(cfg: DictConfig) -> Study:
    """Return the study that compares the optimisers on the single problem of the configuration."""
    from lmd.core.checks import choice
    from lmd.optimisers.ledger import curve

    from .operations.tracking import RunStart

    problem, budget, seeds = build_problem(cfg), budget_of(cfg), seeds_of(cfg)

    configs: dict[str, DictConfig] = {}
    for entry in map(str, cfg.optimisers):
        own = _composed(entry, entry, lambda key: key.split(".")[0] not in OWN_KEYS and changes_results(key))
        own.budget, own.threads = cfg.budget, 1
        build_optimiser(own, cfg.seed).check(problem)  # checked before any search begins
        configs[entry] = own
    reference = None if cfg.reference is None else choice("reference", cfg.reference, list(configs))
    directory, dataset = run_directory(), dataset_of(cfg, problem)
    axis, title = "evaluations" if budget.evaluations else "wall_time", title_of(problem, f"{len(seeds)} seeds,")
    # Tables of these runs then have the columns of tables of `optimise`.
    shared = parameters(cfg, choices()) | derived(problem)

    def log(job: Contender, run: "OptimiserRun", parent: str | None) -> None:
        folder, params = job.folder(directory), {**shared, "optimiser": run.optimiser, "seed": run.seed}
        started = RunStart(job.name, folder, params, job.tags, run.history[-1].wall_time, dataset)
        log_child(cfg.tracking, started, parent, run.metrics, curve(run.history, budget))

    def report(done: "Mapping[Contender, OptimiserRun]") -> Report:
        from lmd.evaluation.comparison import compared, comparison_markdown
        from lmd.objectives.base import figure_of
        from lmd.plot.charts import save_comparison_figure

        runs, fitness = list(done.values()), figure_of("fitness")  # fitness is maximised
        comparison = compared(runs, fitness.key, reference)
        markdown = comparison_markdown(comparison, fitness)
        files = {
            "comparison.csv": comparison.table,
            "comparison.md": markdown,
            "comparison.png": lambda path: save_comparison_figure(path, runs, axis, fitness, title),
            **({} if comparison.pairs is None else {"p_values.csv": comparison.pairs.rename_axis("optimiser")}),
        }
        return Report(files, text=f"\n{markdown}")

    jobs = [Contender(name, configs[name], seed) for seed in seeds for name in configs]
    return contend(cfg, jobs, report, log, problem=problem)


def _over_suite(cfg: DictConfig) -> Study:
    """Return the study that compares the optimisers on problems of the suite and writes the leaderboard.

    Raises:
        InputError: a setting has a value that is not allowed.
    """
    from lmd.core.checks import InputError, choice
    from lmd.suite import document

    boxes = problems_of(cfg)
    budgets = {name: list(document(name).budgets) for name in boxes}
    places = [BUDGETS.index(choice("suite_budgets", str(place), BUDGETS)) for place in cfg.suite_budgets]
    taken = {entry: _taken(entry, cfg, boxes) for entry in map(str, cfg.optimisers)}
    if not places:
        raise InputError("suite_budgets must list at least one of 1, 2 and 3, got [].", "suite_budgets")
    jobs = [
        Contender(entry, taken[entry][name], seed, name, budgets[name][place])
        for seed, place, name, entry in product(seeds_of(cfg), places, boxes, taken)
        if name in taken[entry]
    ]

    def report(done: "Mapping[Contender, OptimiserRun]") -> Report:
        from lmd.suite.leaderboard import leaderboard, write_runs

        by_place: dict[int, list[OptimiserRun]] = {0: [], 1: [], 2: []}
        for job, run in done.items():
            by_place[budgets[job.problem].index(job.evaluations)].append(run)
        write_runs(run_directory() / "iohprofiler", by_place, boxes)
        found = leaderboard(by_place, boxes)
        text = f"{found.text}\n## Configurations\n\n{_configurations(taken)}\n"
        return Report({"leaderboard.md": text, "leaderboard.csv": found.table}, found.figures, text=f"\n{text}")

    about = f"{len(boxes)} problems, {len(cfg.optimisers)} optimisers, {cfg.seeds} seeds"
    return contend(cfg, jobs, report, about=about)


def _configurations(taken: Mapping[str, Mapping[str, DictConfig]]) -> str:
    """Markdown table with the exact configuration that was used for each entry of `optimisers`, one row per entry.

    Args:
        taken: for each entry, its configuration on each problem by the name of the problem.
    """
    from lmd.core.words import as_code, markdown_table

    flat = {entry: flat_settings(next(iter(configs.values())), "optimiser") for entry, configs in taken.items()}
    rows = [
        [as_code(entry), as_code(" ".join(f"{key.removeprefix('optimiser.')}={value}" for key, value in found.items()))]
        for entry, found in flat.items()
    ]
    return markdown_table(["optimiser", "configuration"], rows)


def problems_of(cfg: DictConfig) -> "Mapping[str, BlackBox]":
    """Problems of the suite that the key `suite` chooses, by name.

    The value of the key is the name of a set of problems, the name of a problem, or a list of names of problems. In a
    set, only the problems with a single objective are used.

    Raises:
        InputError: there is no such problem, or the configuration also chooses parts of a problem.
    """
    from lmd.core.checks import InputError, integer
    from lmd.suite import names, problem
    from lmd.suite.documents import SETS
    from lmd.suite.families import instance_name

    if chosen := [key for key, _ in task_overrides() if re.split("[.@]", key)[0] in GROUPS]:
        raise InputError(f"suite = {cfg.suite} sets {chosen[0]} itself: leave {chosen[0]} out.", "suite")
    asked = plain(cfg.suite)
    families = asked if isinstance(asked, list) else names(asked) if asked in SETS else [asked]
    instances = [integer("instances", each, low=0) for each in cfg.instances]
    every = [instance_name(str(name), each) for each in instances for name in families]
    boxes = {name: problem(name) for name in every}
    several = [name for name, box in boxes.items() if len(box.objectives) > 1]
    if several and asked not in SETS:
        raise InputError(f"suite: {several[0]} has several objectives, but compare needs a single one.", "suite")
    return {name: box for name, box in boxes.items() if name not in several}


def _taken(entry: str, cfg: DictConfig, boxes: "Mapping[str, BlackBox]") -> dict[str, DictConfig]:
    """Configuration of an entry of `optimisers` for each supported problem, by the name of the problem.

    A note is printed for each problem that the entry's optimiser does not support.

    Raises:
        InputError: the optimiser supports none of the problems.
    """
    from lmd.core.checks import InputError

    taken, refused = dict[str, DictConfig](), ""
    known = {words: _composed(entry, words, "validate".__eq__) for words in (entry, CAMERAS.get(entry, entry))}
    for name, box in boxes.items():
        composed = known[entry if box.problem.genome is None else CAMERAS.get(entry, entry)]
        try:
            build_optimiser(composed, cfg.seed).check(box.problem)
            taken[name] = composed
        except InputError as error:
            refused = str(error)
            note(f"{entry} cannot solve {name}: {error}")
    if not taken:
        raise InputError(f"optimisers: {entry!r} can solve none of the problems: {refused}", "optimisers")
    return taken


def _composed(entry: str, words: str, is_shared: Callable[[str], bool]) -> DictConfig:
    """Compose the configuration of `optimise` for an entry of `optimisers`.

    Args:
        entry: the entry, for error messages.
        words: name of the optimiser followed by overrides, separated by spaces.
        is_shared: function of a key; True if an override of this key on the command line is also used.
    """
    shared = [override for key, override in task_overrides() if is_shared(key)]
    name, *own = words.split()
    return editable(recompose("optimise", [*shared, f"optimiser={name}", *own], "optimisers", entry))


main = Command("compare", compare)

if __name__ == "__main__":
    main()
