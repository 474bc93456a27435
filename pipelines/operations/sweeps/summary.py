"""Results of a sweep: a table of the jobs, and metrics of groups of jobs for the tracked run.

A group consists of jobs that differ only in the seed. A median or a best value is never taken across groups, because
groups have different problems or methods.
"""

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from ...composing import GROUPS
from ...outputs import HISTORY_FILE, read_history
from .folder import Job, JobFolder, Sweep
from .names import SEED

# Figures of jobs that become columns of the table if any job has them.
FIGURES = (
    *("fitness", "off_grid", "qualified_ratio", "average_coverage_probability", "maximum_coverage_probability"),
    *("localised_share", "weighted_share"),
)
DESCRIBED = {"fitness": "fitness", "off_grid": "off the grid"}  # figures of groups, with their labels
# Keys of the problem: jobs that differ in a key of these have different problems.
PROBLEM = (*GROUPS, "experiment", "run", *(f"deployment.{key}" for key in ("count", "fixed", "free", "measured")))
MOST_COLUMNS = 12  # a key with at most this number of values gets columns in a table of groups
Group = tuple[str, ...]  # values of the grouping keys


class Outcome(NamedTuple):
    """Job of a sweep together with its metrics."""

    folder: JobFolder
    """Folder of the job."""
    job: Job
    """Record of the job."""
    figures: Mapping[str, Any]
    """Metrics of the job, the content of metrics.json; empty if the job has not finished."""


def outcomes(jobs: Iterable[tuple[JobFolder, Job]]) -> list[Outcome]:
    """Jobs together with their metrics, which are read from the jobs' folders."""
    return [Outcome(folder, job, folder.figures() if job.status == "finished" else {}) for folder, job in jobs]


def write_jobs(path: Path, sweep: Sweep, found: list[Outcome]) -> None:
    """Write a CSV table with a row for each job.

    The columns are the folder, the varied keys, the status, the metrics, the seconds, and the reason of a failure.
    """
    known = [key for key in FIGURES if _values(found, key)]
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, ["folder", *sweep.varied, "status", *known, "seconds", "reason"], restval="")
        writer.writeheader()
        for folder, job, figures in found:
            row = {"folder": folder.name, **job.varied, "status": job.status, "seconds": round(job.seconds, 1)}
            writer.writerow(row | {key: figures[key] for key in known if key in figures} | {"reason": job.reason})


def best_group(sweep: Sweep, found: list[Outcome]) -> dict[str, float]:
    """Metrics of the group of jobs with the highest median fitness.

    For each metric, the result has the best value and the median over the seeds. The result is empty if the jobs have
    different problems or none has a fitness.
    """
    known = [members for members in _groups(sweep, found).values() if _values(members, "fitness")]
    if not known or any(map(_is_of_problem, grouping_keys(sweep))):
        return {}
    best = max(known, key=lambda members: median(_values(members, "fitness")))
    values = {key: _values(best, key) for key in FIGURES if _values(best, key)}
    best_of = {f"best/{key}": max(each) for key, each in values.items()}
    return best_of | {f"median/{key}": median(each) for key, each in values.items()}


def draw_groups(path: Path, sweep: Sweep, found: list[Outcome]) -> list[Path]:
    """Draw the best fitness of each group of jobs, as the median over its finished searches.

    The picture shows the fitness against the number of evaluations, and its final value against a varied key.

    Returns:
        list with the path of the picture; empty if no search has finished.
    """
    from lmd.plot.charts import Searched, save_groups_figure

    def searched(members: list[Outcome]) -> list[Searched]:
        scored = [each for each in members if "fitness" in each.figures and (each.folder.path / HISTORY_FILE).is_file()]
        known = [(each.figures, read_history(each.folder.path / HISTORY_FILE)) for each in scored]
        return [Searched(rows, has["fitness"], has.get("off_grid")) for has, rows in known if rows]

    groups = {group: searches for group, each in _groups(sweep, found).items() if (searches := searched(each))}
    if not groups:
        return []
    save_groups_figure(path, groups, grouping_keys(sweep), " x ".join(grouping_keys(sweep)))
    return [path]


def by_group(sweep: Sweep, found: list[Outcome]) -> str:
    """Table in Markdown with a row for each group of jobs: best value and median of each metric over the group.

    If two or more keys vary, a table of medians comes first. This table has a column for each value of the first of the
    `grouping_keys` (at most `MOST_COLUMNS`), and a row for each combination of values of the other keys.
    """
    from lmd.core.words import escaped, markdown_table

    labels = {key: label for key, label in DESCRIBED.items() if _values(found, key)}
    head = [*map(escaped, grouping_keys(sweep)), "jobs finished"]
    head += [f"{label}: {figure}" for label in labels.values() for figure in ("best", "median")]
    rows, cells = [], dict[Group, dict[str, str]]()
    for group, members in _groups(sweep, found).items():
        values = [_values(members, key) for key in labels]
        figures = [f"{figure(each):.2%}" if each else "" for each in values for figure in (max, median)]
        finished = sum(each.job.status == "finished" for each in members)
        rows.append([*map(escaped, group), f"{finished} of {len(members)}", *figures])
        if len(group) > 1:
            on, off = (_values(members, key) for key in DESCRIBED)
            further = f" ({median(off):.2%} off the grid)" if off else ""
            cells.setdefault(group[1:], {})[group[0]] = f"{median(on):.2%}{further}" if on else ""
    table = markdown_table(head, rows)
    columns = list(dict.fromkeys(value for row in cells.values() for value in row))
    if not 0 < len(columns) <= MOST_COLUMNS:
        return table
    first, *others = grouping_keys(sweep)
    across = [[*map(escaped, down), *(row.get(value, "") for value in columns)] for down, row in cells.items()]
    medians = markdown_table([*map(escaped, [*others, *(f"{first}={value}" for value in columns)])], across)
    return f"Medians over {SEED}s, on the grid and off it:\n\n{medians}\n\n{table}"


def grouping_keys(sweep: Sweep) -> list[str]:
    """Keys by which jobs are grouped: all varied keys except the seed.

    The keys that choose the method, such as the optimiser, come first, then the keys of the problem.
    """
    return sorted((key for key in sweep.varied if key != SEED), key=_is_of_problem)


def _is_of_problem(key: str) -> bool:
    return any(key == part or key.startswith(f"{part}.") for part in PROBLEM)


def _groups(sweep: Sweep, found: list[Outcome]) -> dict[Group, list[Outcome]]:
    """Outcomes of the jobs, grouped by the values of the keys that `grouping_keys` returns."""
    groups = dict[Group, list[Outcome]]()
    for each in found:
        groups.setdefault(tuple(each.job.varied.get(key, "") for key in grouping_keys(sweep)), []).append(each)
    return groups


def _values(found: list[Outcome], key: str) -> list[float]:
    return [each.figures[key] for each in found if key in each.figures]
