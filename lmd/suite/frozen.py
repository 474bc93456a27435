"""Problems of the suite, built from their documents.

Best candidates known of the problems of the suite: `problems/best`, each evaluated by the NumPy reference.

A deployment is a table of landmarks, cameras are a rig file, and a front is a table of landmarks with the number of the
point in the column `point`.
"""

import importlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lmd.cameras.mounts import MountSpace
from lmd.cameras.problem import CameraProblem
from lmd.core.checks import FloatArray, InputError
from lmd.core.tables import read_table
from lmd.formats.rigs import read_mounts, rig_of
from lmd.geometry.camera import Camera
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.rig import Rig
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator
from lmd.suite.black_box import BlackBox
from lmd.suite.documents import FOLDER, Document, document, with_paths
from lmd.suite.several import SeveralObjectives, TagChoice

TARGET = "_target_"
COUNTED = {"tags": False, "paper": True}
"""Second objective of a problem that chooses tags, and a flag: weigh tags by paper."""


def problem(name: str, threads: int | None = 1) -> BlackBox:
    """Return a problem of the suite as a function on the unit box.

    Args:
        name: one of `names()`.
        threads: worker threads; None for all processors. The values do not depend on it.

    Raises:
        InputError: no problem has that name.
    """
    return build(document(name), threads)


def build(frozen: Document, threads: int | None = 1) -> BlackBox:
    """Build the problem of a document; see `problem`."""
    given = with_paths(frozen.problem)
    nodes = {key: _made(node) for key, node in given.items() if key not in ("camera", "cameras")}
    camera, mounts = camera_of(frozen), given["camera"].get("rig")
    seen_by = camera if mounts is None else rig_of(mounts, camera)
    scene = Scene(nodes["room"], seen_by, nodes["pdf"], nodes["visibility"], nodes["tag"])

    def with_objective(objective: Any) -> Problem:
        return Problem(scene, objective, nodes["deployment"], threads)

    encoding = nodes["encoding"]["kind"]
    if "objectives" in nodes:
        return SeveralObjectives([with_objective(each) for each in nodes["objectives"]], frozen.name, encoding)
    single = with_objective(nodes["objective"])
    if "second" in nodes:
        return TagChoice(single, frozen.name, encoding, by_paper=COUNTED[nodes["second"]])
    if "cameras" in frozen.problem:
        space = MountSpace(body=nodes["body"], lenses=[camera], **frozen.problem["cameras"])
        single = CameraProblem(single, single.draw(np.random.default_rng(0)), space)
    return BlackBox(single, frozen.name, encoding)


def camera_of(frozen: Document) -> Camera:
    """Return the camera of a problem, which all mounts of a rig share."""
    camera: Camera = _made({key: value for key, value in frozen.problem["camera"].items() if key != "rig"})
    return camera


def _made(node: Any) -> Any:
    """The object that a node describes, with all nodes within it."""
    if isinstance(node, list):
        return [_made(each) for each in node]
    if not isinstance(node, Mapping):
        return node
    arguments = {key: _made(value) for key, value in node.items() if key != TARGET}
    if TARGET not in node:
        return arguments
    module, _, name = str(node[TARGET]).rpartition(".")
    return getattr(importlib.import_module(module), name)(**arguments)


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
