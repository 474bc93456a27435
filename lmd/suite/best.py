"""Best candidates known of the problems of the suite: `problems/best`, each evaluated by the NumPy reference.

A deployment is a table of landmarks, cameras are a rig file, and a front is a table of landmarks with the number of the
point in the column `point`.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.core.tables import read_table
from lmd.formats.rigs import read_mounts, rig_of
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.rig import Rig
from lmd.sight.evaluator import Evaluator
from lmd.suite.documents import FOLDER, Document, document
from lmd.suite.frozen import camera_of

POINT = "point"
"""Column of the table of a front."""


def best_path(frozen: Document) -> Path:
    """File of the best candidate known of a problem."""
    kind = "yaml" if "cameras" in frozen.problem else "csv"
    return FOLDER / "best" / f"{frozen.name}.{kind}"


def best_deployments(name: str) -> list[Deployment]:
    """Best deployment known of a problem, or the front of a problem with several objectives.

    Raises:
        InputError: no problem has that name, nothing is recorded, or the problem places cameras.
    """
    path = best_path(_recorded(name))
    if path.suffix != ".csv":
        raise InputError(f"suite: {name} places cameras, not landmarks.", "suite")
    table = read_table(path, name="suite")
    every = Deployment.from_table(table)
    if POINT not in table:
        return [every]
    point = table.numbers([POINT], None)[:, 0]
    return [replace(every[point == each], labels=None) for each in np.unique(point)]


def best_rig(name: str) -> Rig:
    """Best cameras known of a problem that places cameras.

    Raises:
        InputError: no problem has that name, nothing is recorded, or the problem places landmarks.
    """
    path = best_path(_recorded(name))
    if path.suffix == ".csv":
        raise InputError(f"suite: {name} places landmarks, not cameras.", "suite")
    return rig_of(read_mounts(str(path)), camera_of(document(name)))


def reference_fitness(problem: Problem, deployment: Deployment) -> float:
    """Fitness of a deployment by the NumPy reference, which shares no kernel with the optimisers."""
    fast = problem.fitness_evaluator
    slow = Evaluator(fast.scene, fast.positions, fast.threads, True, fast.states).sized(deployment.edges)
    values: FloatArray = problem.objective.values(slow, deployment.positions[None], deployment.normals[None])[0]
    return float(problem.fitness_from(values))


def _recorded(name: str) -> Document:
    frozen = document(name)
    if frozen.best is None:
        raise InputError(f"suite: no candidate of {name} is recorded.", "suite")
    return frozen
