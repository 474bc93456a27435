"""Worlds and models of Gazebo in SDF: poses of their visuals.

A pose is `x y z roll pitch yaw`, metres and radians, in the frame of the enclosing element, or of the frame that
`relative_to` names. An included model is read from the folder with its name beside the world, in `models` beside the
world, or in `models` one folder above. If Gazebo saved a `state` with a world, the poses of models in `state` replace
their other poses.

Sources: the SDF specification (sdformat.org), "Pose Frame Semantics"; `World::LoadModels` of Gazebo classic.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from lmd.core.checks import FloatArray, InputError, bounded
from lmd.core.files import read_text
from lmd.formats.opencv_calibrations import xml_of
from lmd.formats.placed_tag import turn_by_quaternion
from lmd.geometry.frames import roll_pitch_yaw

MODEL_FILE, MODELS = "model.sdf", "models"
LARGEST_MODEL = 1 << 22  # greatest size of the file of a model, bytes
MOST_MODELS = 20_000  # greatest number of models, with those of included models; a city has some thousand
DEEPEST = 20  # greatest number of frames in a chain of references, and of nested models
NAMED = ("link", "model", "frame", "include", "joint")  # elements whose frames others may refer to
SELF = ("", "__model__", "world")
QUATERNION = "quat_xyzw"
COMMENT = re.compile(r"<!--.*?-->|(<!--.*)", re.DOTALL)


class Seen(NamedTuple):
    """Visual or collision of a world."""

    element: Element | None
    """The element; None for an included model that was not found."""
    pose: FloatArray
    """Transform from the element's frame to the world, `(4, 4)`, metres."""
    names: tuple[str, ...]
    """Names of the element and of the enclosing elements, and the model's URI, the innermost first."""


class Models(NamedTuple):
    """Models beside a world."""

    folder: Path
    """Folder of the world."""
    number: Iterator[int]
    """Counter of the models that are placed."""
    read: dict[str, Element | None]
    """Models that were read, by URI."""


@dataclass(frozen=True)
class Scope:
    """World or model, whose elements refer to frames by name."""

    element: Element
    pose: FloatArray
    """Transform from the frame of the world or model to the world, `(4, 4)`."""
    models: Models
    """Models beside the world."""
    names: tuple[str, ...] = ()
    """Names of the enclosing models, the innermost first."""

    @cached_property
    def frames(self) -> dict[str, Element]:
        """Elements with a frame by name; the first of those with equal names."""
        return {_name(element): element for element in reversed(list(self.element)) if element.tag in NAMED}

    def placed(self, element: Element, depth: int = 0) -> FloatArray:
        """Transform from the frame of an element of this scope to the world.

        Raises:
            InputError: a pose is broken, or refers to a missing frame or to itself.
        """
        pose = element.find("pose")
        reference = "" if pose is None else pose.get("relative_to") or pose.get("frame") or ""
        reference = reference or element.get("attached_to") or ""
        base = self.pose if reference in SELF else self.frame(reference, depth + 1)
        return base @ matrix_of(pose, element.get("name", element.tag))

    def frame(self, name: str, depth: int) -> FloatArray:
        """Transform from a frame of this scope to the world; `model::link` names a frame inside a model."""
        if depth > DEEPEST:
            raise InputError(f"the frame {name!r} refers to itself.")
        if name in SELF:
            return self.pose
        if name in self.frames:  # names of a flattened model have :: in them
            return self.placed(self.frames[name], depth)
        first, _, rest = name.partition("::")
        if rest and first in self.frames:
            element = self.frames[first]
            return Scope(element, self.placed(element, depth), self.models).frame(rest, depth + 1)
        raise InputError(f"a pose is relative to the frame {name!r}, which is not in the file.")


def root_of(text: str) -> Element | None:
    """Outermost element of XML, None for another text; comments may contain --, as Gazebo accepts them.

    Raises:
        InputError: the text begins like XML but is broken, or has entities.
    """
    return xml_of(COMMENT.sub(r"\1", text))


def matrix_of(pose: Element | None, name: str) -> FloatArray:
    """Transform of a pose, `(4, 4)`; the identity for an element without a pose.

    Raises:
        InputError: the pose does not have six finite numbers.
    """
    matrix = np.eye(4)
    if pose is None or not (pose.text or "").strip():
        return matrix
    words = (pose.text or "").split()
    by_quaternion = pose.get("rotation_format") == QUATERNION
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        values = np.array([np.nan])
    if len(values) != (7 if by_quaternion else 6) or not np.isfinite(values).all():
        wanted = "x y z qx qy qz qw" if by_quaternion else "x y z roll pitch yaw"
        raise InputError(f"the pose of {name!r} must be {wanted}, got {' '.join(words)[:80]!r}.")
    matrix[:3, 3] = values[:3]
    if by_quaternion:
        matrix[:3, :3] = turn_by_quaternion(*values[3:].tolist())
        return matrix
    angles = np.radians(values[3:]) if pose.get("degrees") in ("true", "1") else values[3:]
    matrix[:3, :3] = roll_pitch_yaw(angles)
    return matrix


def seen_in(root: Element, path: Any, tag: str) -> Iterator[Seen]:
    """All elements `tag`, such as `visual`, of the models of a world or of a file with one model.

    Raises:
        InputError: a pose cannot be resolved.
    """
    models = Models(Path(path).parent, count(1), {})
    worlds = root.findall("world") or [root]
    for world in worlds:
        scope = Scope(world, np.eye(4), models)
        saved = {_name(model): matrix_of(model.find("pose"), _name(model)) for model in world.findall("state/model")}
        yield from _models(scope, tag, saved, 0)


def _models(scope: Scope, tag: str, saved: dict[str, FloatArray], depth: int) -> Iterator[Seen]:
    """Elements of the models in a scope, at the saved poses if there are any."""
    bounded("models in each other", depth, DEEPEST, "it")
    for element in scope.element:
        if element.tag in ("model", "include"):
            bounded("models, with those that they include", next(scope.models.number), MOST_MODELS, "it")
        if element.tag == "model":
            names = (_name(element), *scope.names)
            model, pose = element, scope.placed(element)
        elif element.tag == "include":
            uri = (element.findtext("uri") or "").strip()
            names = tuple(filter(None, (_name(element), uri, *scope.names)))
            if uri not in scope.models.read:
                scope.models.read[uri] = _included(scope.models.folder, uri)
            found = scope.models.read[uri]
            if found is None:
                yield Seen(None, saved.get(_name(element), scope.placed(element)), names)
                continue
            model = found
            pose = scope.placed(element if element.find("pose") is not None else model)
            names = (*names, _name(model))
        else:
            continue
        if element.get("placement_frame") or (element.findtext("placement_frame") or "").strip():
            raise InputError(
                f"the model {names[0]!r} is placed by a placement_frame, which is not read: give its pose."
            )
        inner = Scope(model, saved.get(names[0], pose), scope.models, names)
        for link in model.findall("link"):
            at = inner.placed(link)
            for part in link.findall(tag):
                own = at @ matrix_of(part.find("pose"), part.get("name", tag))
                yield Seen(part, own, tuple(filter(None, (part.get("name"), link.get("name"), *names))))
        yield from _models(inner, tag, {}, depth + 1)


def _name(element: Element) -> str:
    """Name of an element; for an include, the name that it gives the model, or the last part of its URI."""
    if element.tag != "include":
        return element.get("name", "")
    return (element.findtext("name") or "").strip() or (element.findtext("uri") or "").strip().rpartition("/")[2]


def _included(folder: Path, uri: str) -> Element | None:
    """Model of a URI beside a world; None if the model is not found."""
    name = uri.removeprefix("model://").removeprefix("file://").strip("/")
    name = name.removesuffix(f"/{MODEL_FILE}")
    if not name or ".." in Path(name).parts or Path(name).is_absolute():
        return None
    for place in (folder, folder / MODELS, folder.parent / MODELS, folder.parent):
        files = [place / name / MODEL_FILE, *sorted((place / name).glob("*.sdf"))]
        if found := [file for file in files if file.is_file()]:
            try:
                root = root_of(read_text(found[0], "path", LARGEST_MODEL))
            except InputError as error:
                raise InputError(f"the model {name!r} of {found[0]}: {error}") from None
            return None if root is None else root.find("model")
    return None
