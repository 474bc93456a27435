"""What the jobs of a sweep found: as its table, and group by group for its tracked run."""

import csv
from collections.abc import Iterable
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from ...earlier_run import GROUPS
from .folder import Job, JobFolder, Sweep

if TYPE_CHECKING:
    import pandas as pd

# Figures of a job that its row has, if any job of the sweep has them.
FIGURES = (
    *("fitness", "off_grid", "qualified_ratio", "average_coverage_probability", "maximum_coverage_probability"),
    *("localised_share", "weighted_share"),
)
TOLD = {"fitness": "fitness", "off_grid": "off the grid"}  # those that a description has, as it calls them
SEED = "seed"  # jobs that differ in this alone are one group
PROBLEM = (*GROUPS, "deployment.count")  # where these vary, the best of all jobs says nothing
MOST_PANELS = 6

Found = list[tuple[JobFolder, Job, dict[str, Any]]]


def found_by(jobs: Iterable[tuple[JobFolder, Job]]) -> Found:
    """The jobs with their figures, none for those that have not finished."""
    return [(folder, job, folder.figures() if job.status == "finished" else {}) for folder, job in jobs]


def write_table(path: Path, sweep: Sweep, found: Found) -> None:
    """A row for each job: its folder, what varies, its status, its figures, seconds, and why it failed."""
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
    """The best and the median of each figure over all finished jobs; nothing where these had different problems."""
    if any(key == part or key.startswith(f"{part}.") for key in sweep.varied for part in PROBLEM):
        return {}
    summary: dict[str, float] = {}
    for key in FIGURES:
        if values := _values(found, key):
            summary |= {f"best/{key}": max(values), f"median/{key}": median(values)}
    return summary


def description(sweep: Sweep, found: Found) -> str:
    """What varied, and the best and the median of every group of jobs, in Markdown."""
    from lmd.core.words import as_code, escaped, markdown_table

    keys, groups = _groups(sweep, found)
    counts = {key: len({job.varied[key] for _, job, _ in found if key in job.varied}) for key in sweep.varied}
    varied = ", ".join(f"{as_code(key)} ({count} values)" for key, count in counts.items())
    told = {key: label for key, label in TOLD.items() if _values(found, key)}
    head = [
        *map(escaped, keys),
        "jobs finished",
        *(f"{label}: {what}" for label in told.values() for what in ("best", "median")),
    ]
    rows = []
    for group, members in groups.items():
        values = [_values(members, key) for key in told]
        figures = [f"{figure(each):.2%}" if each else "" for each in values for figure in (max, median)]
        rows.append(
            [
                *map(escaped, group),
                f"{sum(job.status == 'finished' for _, job, _ in members)} of {len(members)}",
                *figures,
            ]
        )
    return "\n".join([f"varies: {varied or 'nothing'}", "", markdown_table(head, rows)])


def pivots(sweep: Sweep, found: Found) -> "dict[str, pd.DataFrame]":
    """The median fitness over the first two keys that vary, a table for each group of the others.

    There are none where fewer than two keys vary beside the seed, and where there would be too many to be seen.
    """
    keys, groups = _groups(sweep, found)
    panels = {group[2:] for group in groups}
    if len(keys) < 2 or len(panels) > MOST_PANELS:
        return {}
    import pandas as pd

    rows, columns = ([*dict.fromkeys(group[i] for group in groups)] for i in range(2))
    tables = {}
    for panel in dict.fromkeys(group[2:] for group in groups):
        table = pd.DataFrame(index=pd.Index(rows, name=keys[0]), columns=pd.Index(columns, name=keys[1]), dtype=float)
        for group, members in groups.items():
            if group[2:] == panel and (values := _values(members, "fitness")):
                table.loc[group[0], group[1]] = median(values)
        tables[" ".join(f"{key}={value}" for key, value in zip(keys[2:], panel, strict=True))] = table
    return tables if any(table.notna().any(axis=None) for table in tables.values()) else {}


def _groups(sweep: Sweep, found: Found) -> tuple[list[str], dict[tuple[str, ...], Found]]:
    """The keys that tell groups of jobs apart, and the jobs of each group by its values of them."""
    keys = [key for key in sweep.varied if key != SEED]
    groups: dict[tuple[str, ...], Found] = {}
    for entry in found:
        groups.setdefault(tuple(entry[1].varied.get(key, "") for key in keys), []).append(entry)
    return keys, groups


def _values(found: Found, key: str) -> list[float]:
    return [figures[key] for _, _, figures in found if key in figures]
