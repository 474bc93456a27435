"""Entries to the suite (solutions with their origin), and records (entries with the score of the solution).

An entry is a YAML file with the keys of `ENTRY`. The `candidate` is a list of genes, or the name of a file in the
folder of the entry: a rig file if the problem places cameras, else a table of landmarks. For two objectives, the
candidate is a Pareto front with a deployment for each point: the column `point` of the table has the number of the
point to which a landmark belongs. `problems/best` has the best known candidates and their records.
"""

import datetime
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from lmd.cameras.problem import CameraProblem
from lmd.core.checks import FloatArray, InputError, said_of
from lmd.core.files import read_keys
from lmd.core.tables import read_table
from lmd.evaluation.validation import headline_off_grid, validation_metrics
from lmd.formats.rigs import read_mounts, rig_of
from lmd.formats.tag_maps import FileDeployment
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.rig import Rig
from lmd.sight.evaluator import Evaluator
from lmd.suite.black_box import BlackBox
from lmd.suite.documents import BEST, Document, document
from lmd.suite.frozen import build, camera_of
from lmd.suite.several import SeveralObjectives, TagChoice

ENTRY = ("problem", "who", "how", "when", "candidate")
POINT = "point"
"""Name of the column that has, for each landmark, the number of its point on the Pareto front of two objectives."""


def verify(path: str | Path) -> dict[str, Any]:
    """Compute the score of an entry (a solution with its origin); a score that the file already contains is ignored.

    Args:
        path: file of the entry, or of a record, whose score is computed again.

    Returns:
        the record: the keys of the entry, the `version` and `hash` of the problem, the `scorer` (version of this
        program), and the score. The score consists of `value` and `off_grid`. `value` is the fitness, computed without
        compiled code; for a front of two objectives it is the area (hypervolume) between the origin and the front.
        `off_grid` is the main metric at random poses instead of the grid; None for a front.

    Raises:
        InputError: the file cannot be read, a key is missing, the problem is unknown, or the candidate does not belong
            to the problem.
    """
    path = Path(path)
    keys = read_keys(path, "entry")
    with said_of(path):
        if missing := [key for key in ENTRY if not keys.get(key)]:
            raise InputError(f"an entry has the keys {', '.join(ENTRY)}; {missing[0]} is missing.", "entry")
        try:
            when = datetime.date.fromisoformat(str(keys["when"]))
        except ValueError:
            raise InputError(f"when must be a date such as 2026-11-29, got {keys['when']!r}.", "entry") from None
        frozen = document(str(keys["problem"]))
        score = scored(frozen, keys["candidate"], path.parent)
    return {
        **{key: keys[key] for key in ENTRY},
        "when": when.isoformat(),
        **score,
        "version": frozen.version,
        "hash": frozen.hash,
        "scorer": f"lmd {version('lmd')}",
    }


def scored(frozen: Document, candidate: Any, folder: Path) -> dict[str, float | None]:
    """Score of a candidate: `value` and `off_grid` of a record, keyed by these names, see `verify`.

    Args:
        frozen: document of the problem.
        candidate: genes, or the name of a file in `folder`.
        folder: folder of the entry.

    Raises:
        InputError: the candidate does not belong to the problem.
    """
    box = build(frozen, threads=None)
    if len(box.objectives) > 1:
        points = np.array([_values(box, each) for each in deployments_of(folder / candidate)])
        return {"value": hypervolume(points), "off_grid": None}
    problem, rig = box.problem, None
    if isinstance(candidate, Sequence) and not isinstance(candidate, str):
        genes = np.array(candidate, dtype=np.float64)
        deployment, rig = box.deployment(genes), box.rig(genes)
    elif isinstance(problem, CameraProblem):
        deployment, rig = problem.tags, rig_in(frozen, folder / candidate)
        problem.space.genes(rig)  # raises an error if the mounts of cameras are not admissible
    else:
        source = FileDeployment(str(folder / candidate), count=problem.count)
        deployment = problem.labelled(problem.scene.footprints.draw(source, np.random.default_rng(0)))
    seen = problem if rig is None else problem.with_rig(rig)
    off_grid = validation_metrics(seen, deployment, 0)[headline_off_grid(seen)]
    return {"value": reference_fitness(seen, deployment), "off_grid": round(off_grid, 6)}


def _values(box: BlackBox, deployment: Deployment) -> FloatArray:
    box.problem.scene.footprints.check(deployment)
    assert isinstance(box, SeveralObjectives | TagChoice)
    return box.values_of(deployment)


def hypervolume(points: FloatArray) -> float:
    """Area (hypervolume) between the origin and a front of `points` `(N, 2)`, whose coordinates are to be maximised.

    Each point adds the rectangle with the origin and this point as opposite corners; overlaps count once.
    """
    first, second = points[np.argsort(-points[:, 0])].T
    return float(-np.diff(first, append=0.0) @ np.maximum.accumulate(second))


def best(name: str) -> list[Deployment] | Rig:
    """Best known solution of a problem.

    Returns:
        cameras if the problem places cameras, otherwise a list of deployments: one for each point of the front if the
        problem has several objectives, else a single deployment.

    Raises:
        InputError: no problem has this name, or no solution is recorded for the problem.
    """
    frozen = document(name)
    path = _best(frozen)
    return deployments_of(path) if path.suffix == ".csv" else rig_in(frozen, path)


def deployments_of(path: Path) -> list[Deployment]:
    """Deployments in a table of landmarks: a single deployment, or one for each point of a front."""
    table = read_table(path, name="candidate")
    every = Deployment.from_table(table)
    if POINT not in table:
        return [every]
    point = table.numbers([POINT], None)[:, 0]
    return [replace(every[point == each], labels=None) for each in np.unique(point)]


def rig_in(frozen: Document, path: Path) -> Rig:
    """Read the cameras from a rig file, for a problem that places cameras."""
    return rig_of(read_mounts(str(path)), camera_of(frozen))


def reference_fitness(problem: Problem, deployment: Deployment) -> float:
    """Fitness of a deployment, computed by the NumPy reference, which shares no compiled code with the optimisers."""
    fast = problem.fitness_evaluator
    slow = Evaluator(fast.scene, fast.positions, fast.threads, True, fast.states).sized(deployment.edges)
    values: FloatArray = problem.objective.values(slow, deployment.positions[None], deployment.normals[None])[0]
    return float(problem.fitness_from(values))


def _best(frozen: Document) -> Path:
    if frozen.best is None:
        raise InputError(f"suite: no candidate of {frozen.name} is recorded.", "suite")
    return BEST / str(frozen.best["candidate"])
