"""Results of the jobs of a sweep: a table of jobs, and a description by groups for the tracked run."""

import csv
from collections.abc import Iterable
from pathlib import Path
from statistics import median
from typing import Any

from ...earlier_run import GROUPS
from .folder import Job, JobFolder, Sweep

# Figures of jobs that are columns of the table, if any job has them.
FIGURES = (
    *("fitness", "off_grid", "qualified_ratio", "average_coverage_probability", "maximum_coverage_probability"),
    *("localised_share", "weighted_share"),
)
DESCRIBED = {"fitness": "fitness", "off_grid": "off the grid"}  # figures in a description, with their labels
SEED = "seed"  # jobs that differ only in this key form a group
PROBLEM = (*GROUPS, "deployment.count")  # keys of the problem; figures of different problems are not compared

Found = list[tuple[JobFolder, Job, dict[str, Any]]]


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
    """Best value and median of each figure over all finished jobs; empty if the jobs have different problems."""
    if any(key == part or key.startswith(f"{part}.") for key in sweep.varied for part in PROBLEM):
        return {}
    summary: dict[str, float] = {}
    for key in FIGURES:
        if values := _values(found, key):
            summary |= {f"best/{key}": max(values), f"median/{key}": median(values)}
    return summary


def description(sweep: Sweep, found: Found) -> str:
    """Description in Markdown: varied keys, and best value and median of every group of jobs."""
    from lmd.core.words import as_code, escaped, markdown_table

    keys = [key for key in sweep.varied if key != SEED]
    groups: dict[tuple[str, ...], Found] = {}
    for entry in found:
        groups.setdefault(tuple(entry[1].varied.get(key, "") for key in keys), []).append(entry)
    counts = {key: len({job.varied[key] for _, job, _ in found if key in job.varied}) for key in sweep.varied}
    varied = ", ".join(f"{as_code(key)} ({count} values)" for key, count in counts.items())
    labels = {key: label for key, label in DESCRIBED.items() if _values(found, key)}
    head = [*map(escaped, keys), "jobs finished"]
    head += [f"{label}: {figure}" for label in labels.values() for figure in ("best", "median")]
    rows = []
    for group, members in groups.items():
        values = [_values(members, key) for key in labels]
        figures = [f"{figure(each):.2%}" if each else "" for each in values for figure in (max, median)]
        finished = sum(job.status == "finished" for _, job, _ in members)
        rows.append([*map(escaped, group), f"{finished} of {len(members)}", *figures])
    return "\n".join([f"varies: {varied or 'nothing'}", "", markdown_table(head, rows)])


def _values(found: Found, key: str) -> list[float]:
    return [figures[key] for _, _, figures in found if key in figures]
