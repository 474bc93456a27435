"""Results of the jobs of a sweep: a table of jobs, and figures by group for its tracked run.

A group is the jobs that differ in their seed alone. Figures are over one group, never over several: groups are of
different problems or methods.
"""

import csv
from collections.abc import Iterable
from pathlib import Path
from statistics import median
from typing import Any

from ...composing import GROUPS
from .folder import Job, JobFolder, Sweep
from .names import SEED, in_name, shown

# Figures of jobs that are columns of the table, if any job has them.
FIGURES = (
    *("fitness", "off_grid", "qualified_ratio", "average_coverage_probability", "maximum_coverage_probability"),
    *("localised_share", "weighted_share"),
)
DESCRIBED = {"fitness": "fitness", "off_grid": "off the grid"}  # figures in a description, with their labels
# Keys of the problem: jobs that differ in one of them have different problems.
PROBLEM = (*GROUPS, "experiment", "run", *(f"deployment.{key}" for key in ("count", "fixed", "free", "measured")))
WITHOUT = "covered_without_"  # begin of the names of figures of criteria, see `lmd.evaluation.verdicts.Causes.metrics`
MOST_COLUMNS = 12  # values of a key beyond which it is no head of a pivot table

Found = list[tuple[JobFolder, Job, dict[str, Any]]]
Groups = dict[tuple[str, ...], Found]  # by the values of the varied keys but the seed


def found_by(jobs: Iterable[tuple[JobFolder, Job]]) -> Found:
    """Jobs with their figures, which are empty for unfinished jobs."""
    return [(folder, job, folder.figures() if job.status == "finished" else {}) for folder, job in jobs]


def write_jobs(path: Path, sweep: Sweep, found: Found) -> None:
    """Write a row for each job: folder, varied keys, status, figures, seconds, reason of a failure."""
    known = [key for key in FIGURES if any(key in figures for _, _, figures in found)]
    rows = [
        {"folder": folder.name, **job.varied, "status": job.status}
        | {key: figures.get(key, "") for key in known}
        | {"seconds": round(job.seconds, 1), "reason": job.reason}
        for folder, job, figures in found
    ]
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, ["folder", *sweep.varied, "status", *known, "seconds", "reason"])
        writer.writeheader()
        writer.writerows(rows)


def best_and_median(sweep: Sweep, found: Found) -> dict[str, float]:
    """Best value and median of each figure over the seeds of the best group; empty if problems differ."""
    _, members = _best(sweep, found)
    summary: dict[str, float] = {}
    for key in FIGURES:
        if values := _values(members, key):
            summary |= {f"best/{key}": max(values), f"median/{key}": median(values)}
    return summary


def draw_groups(path: Path, sweep: Sweep, found: Found) -> list[Path]:
    """Draw the groups of finished searches; returns the pictures, of which there is none without a search."""
    from lmd.core.tables import read_numbers
    from lmd.optimisers.ledger import Record
    from lmd.plot.charts import Searched, save_groups_figure

    from ...score import HISTORY_FILE, columns_of

    groups: dict[tuple[str, ...], list[Searched]] = {}
    for group, members in _groups(sweep, found).items():
        for folder, _, figures in members:
            history = folder.path / HISTORY_FILE
            if "fitness" in figures and history.is_file():
                rows = read_numbers(history, [*columns_of([])], name="history").tolist()
                if rows:
                    search = Searched([Record(*row) for row in rows], figures["fitness"], figures.get("off_grid"))
                    groups.setdefault(group, []).append(search)
    if not groups:
        return []
    keys = grouping_keys(sweep)
    save_groups_figure(path, groups, keys, " ".join(filter(None, [" x ".join(keys), in_name(sweep.given)])))
    return [path]


def why_nothing(found: Found) -> str:
    """The criterion that keeps all finished jobs from covering anything, a sentence; empty if one covers something."""
    values, causes = _values(found, "fitness"), [figures.get("criteria") for _, _, figures in found]
    if any(values) or not values:
        return ""
    first = next((each for each in causes if each), None)
    if first is None:
        return "no job qualifies any position"
    without = {key.removeprefix(WITHOUT): share for key, share in first.items() if key.startswith(WITHOUT)}
    worst = max(without, key=lambda name: without[name])
    excluded = f"{worst.replace('_', ' ')} excludes most: without it {without[worst]:.2%} of single landmarks"
    return f"no job qualifies any position; {excluded} would be covered, with it {first['covered']:.2%}"


def description(sweep: Sweep, found: Found, total: int) -> str:
    """Description in Markdown: the best group if all have one problem, varied keys, figures of every group.

    Args:
        sweep: the sweep.
        found: its jobs that have begun.
        total: number of its jobs.
    """
    from lmd.core.words import as_code

    finished = sum(job.status == "finished" for _, job, _ in found)
    first = [f"{finished} of {total} jobs finished", *_best_group(sweep, found), "by group: artifact `by_group.md`"]
    counts = {key: len({job.varied[key] for _, job, _ in found if key in job.varied}) for key in sweep.varied}
    varied = ", ".join(f"{as_code(key)} ({count} values)" for key, count in counts.items())
    return "\n\n".join(["; ".join(first), f"varies: {varied or 'nothing'}", by_group(sweep, found)])


def by_group(sweep: Sweep, found: Found) -> str:
    """The best and the median of every group of jobs, a table in Markdown."""
    from lmd.core.words import escaped, markdown_table

    labels = {key: label for key, label in DESCRIBED.items() if _values(found, key)}
    head = [*map(escaped, grouping_keys(sweep)), "jobs finished"]
    head += [f"{label}: {figure}" for label in labels.values() for figure in ("best", "median")]
    rows = []
    for group, members in _groups(sweep, found).items():
        values = [_values(members, key) for key in labels]
        figures = [f"{figure(each):.2%}" if each else "" for each in values for figure in (max, median)]
        finished = sum(job.status == "finished" for _, job, _ in members)
        rows.append([*map(escaped, group), f"{finished} of {len(members)}", *figures])
    return markdown_table(head, rows)


def pivot(sweep: Sweep, found: Found) -> str:
    """The median of each group, a table in Markdown with the first grouping key across and the others down.

    Empty if no two keys vary, or the first one has too many values.
    """
    from lmd.core.words import escaped, markdown_table

    keys, groups = grouping_keys(sweep), _groups(sweep, found)
    columns = list(dict.fromkeys(group[0] for group in groups if group))
    if len(keys) < 2 or len(columns) > MOST_COLUMNS:
        return ""
    cells: dict[tuple[str, ...], dict[str, str]] = {}
    for (first, *others), members in groups.items():
        cells.setdefault(tuple(others), {})[first] = _median_text(members)
    head = [*keys[1:], *(f"{keys[0]}={value}" for value in columns)]
    rows = [[*map(escaped, down), *(row.get(value, "") for value in columns)] for down, row in cells.items()]
    return markdown_table(list(map(escaped, head)), rows)


def _median_text(members: Found) -> str:
    """Medians of a group, `44.44% (26.00% off the grid)`; empty without a finished job."""
    on, off = (_values(members, key) for key in DESCRIBED)
    further = f" ({median(off):.2%} off the grid)" if off else ""
    return f"{median(on):.2%}{further}" if on else ""


def _best(sweep: Sweep, found: Found) -> tuple[tuple[str, ...], Found]:
    """The group with the highest median fitness and its jobs; no jobs if problems differ."""
    known = {group: members for group, members in _groups(sweep, found).items() if _values(members, "fitness")}
    if not known or any(map(_is_of_problem, grouping_keys(sweep))):
        return (), []
    best = max(known, key=lambda group: median(_values(known[group], "fitness")))
    return best, known[best]


def _best_group(sweep: Sweep, found: Found) -> list[str]:
    """The group with the highest median fitness, a phrase in Markdown; nothing if problems differ."""
    from lmd.core.words import as_code

    best, members = _best(sweep, found)
    if not members:
        return []
    label = " ".join(shown(key, value) for key, value in zip(grouping_keys(sweep), best, strict=True))
    finished = len(_values(members, "fitness"))
    over = f"the median of {finished} jobs" if finished > 1 else "one job"
    named = f"{as_code(label)}: " if label else ""
    return [f"best: {named}{_median_text(members)}, {over}"]


def _is_of_problem(key: str) -> bool:
    return any(key == part or key.startswith(f"{part}.") for part in PROBLEM)


def grouping_keys(sweep: Sweep) -> list[str]:
    """The varied keys but the seed: those of the method, such as the optimiser, before those of the problem."""
    return sorted((key for key in sweep.varied if key != SEED), key=_is_of_problem)


def _groups(sweep: Sweep, found: Found) -> Groups:
    groups: Groups = {}
    for entry in found:
        groups.setdefault(tuple(entry[1].varied.get(key, "") for key in grouping_keys(sweep)), []).append(entry)
    return groups


def _values(found: Found, key: str) -> list[float]:
    return [figures[key] for _, _, figures in found if key in figures]
