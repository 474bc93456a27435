"""Problems of the suite, built from their documents."""

import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from lmd.cameras.mounts import MountSpace
from lmd.cameras.problem import CameraProblem
from lmd.formats.rigs import rig_of
from lmd.geometry.camera import Camera
from lmd.problem import Problem
from lmd.scene.scene import Scene
from lmd.suite.black_box import BlackBox
from lmd.suite.documents import Document, document, with_paths
from lmd.suite.families import TARGET, instance_name
from lmd.suite.several import SeveralObjectives, TagChoice

COUNTED = {"tags": False, "paper": True}
"""Names of the second objective of a problem in which tags may be left out (`TagChoice`). The value is True if each tag
counts with the area of its paper, False if each tag counts as one.
"""


def problem(name: str, threads: int | None = 1, instance: int = 0) -> BlackBox:
    """Return a problem of the suite as a function on the unit box.

    Args:
        name: one of `names()`, or the name of an instance, such as `tiny_mean-3`.
        instance: number of a random variant of the problem `name`, see `lmd.suite.families`; 0 is the problem itself.
            No optimiser is tuned on instances from 1000 on (held-out instances).
        threads: number of worker threads; None for all processors. The values do not depend on this number.

    Raises:
        InputError: no problem has that name.
    """
    return build(document(instance_name(name, instance)), threads)


def build(frozen: Document, threads: int | None = 1) -> BlackBox:
    """Build the problem that a document describes, see `problem`."""
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
    """Return the camera of a problem; all mounts of a rig have this camera."""
    camera: Camera = _made({key: value for key, value in with_paths(frozen.problem["camera"]).items() if key != "rig"})
    return camera


def _made(node: Any) -> Any:
    """Make the object that `node` describes: a mapping with a class (`_target_`) and its arguments, perhaps nested."""
    if isinstance(node, list):
        return [_made(each) for each in node]
    if not isinstance(node, Mapping):
        return node
    arguments = {key: _made(value) for key, value in node.items() if key != TARGET}
    if TARGET not in node:
        return arguments
    module, _, name = str(node[TARGET]).rpartition(".")
    return getattr(importlib.import_module(module), name)(**arguments)
