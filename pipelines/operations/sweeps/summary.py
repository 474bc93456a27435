"""Results of the jobs of a sweep: a table of jobs, and figures by group for its tracked run.

A group is the jobs that differ in their seed alone. Figures are over one group, never over several: groups are of
different problems or methods.
"""

import csv
from collections.abc import Iterable
from pathlib import Path
from statistics import median
from typing import Any

from ...earlier_run import GROUPS
from .folder import Job, JobFolder, Sweep
from .names import SEED, shown

# Figures of jobs that are columns of the table, if any job has them.
FIGURES = (
    *("fitness", "off_grid", "qualified_ratio", "average_coverage_probability", "maximum_coverage_probability"),
    *("localised_share", "weighted_share"),
)
DESCRIBED = {"fitness": "fitness", "off_grid": "off the grid"}  # figures in a description, with their labels
# Keys of the problem: jobs that differ in one of them have different problems.
PROBLEM = (*GROUPS, "experiment", "run", *(f"deployment.{key}" for key in ("count", "fixed", "free", "measured")))
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
    """Best value and median of each figure over the seeds; empty if the jobs are of several groups."""
    summary: dict[str, float] = {}
    if len(_groups(sweep, found)) == 1:
        for key in FIGURES:
            if values := _values(found, key):
                summary |= {f"best/{key}": max(values), f"median/{key}": median(values)}
    return summary


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


def _best_group(sweep: Sweep, found: Found) -> list[str]:
    """The group with the highest median fitness, a phrase in Markdown; nothing if problems differ."""
    from lmd.core.words import as_code

    keys = grouping_keys(sweep)
    known = {group: members for group, members in _groups(sweep, found).items() if _values(members, "fitness")}
    if not known or any(map(_is_of_problem, keys)):
        return []
    best = max(known, key=lambda group: median(_values(known[group], "fitness")))
    label = " ".join(shown(key, value) for key, value in zip(keys, best, strict=True))
    over = f"the median of {len(_values(known[best], 'fitness'))} jobs" if len(known[best]) > 1 else "one job"
    named = f"{as_code(label)}: " if label else ""
    return [f"best: {named}{_median_text(known[best])}, {over}"]


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
