"""Checkpoints: states of optimisers as data, their file, and checks of all that is read from it.

A checkpoint holds data and no code: an optimiser made from the configuration takes over the state that is read. The
file is an archive of NumPy's, with the arrays and a document in JSON, and nothing in it is unpickled. It may have been
written by an attacker, and kernels do not check indices, so each value is checked.
"""

import io
import json
import sys
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import DTypeLike

from lmd.core.checks import FloatArray, InputError, file_path, integer, said_of
from lmd.core.files import write_whole
from lmd.core.memory import check_memory
from lmd.problem import Problem
from lmd.scene.deployment import HUNG, Deployment
from lmd.space.surface import NEAR_SURFACE

CHECKPOINT_FILE = "checkpoint.npz"
FORMAT = "lmd checkpoint 4"  # its number changes with the content of the file
DOCUMENT_KEY = "document"  # name of the JSON document, UTF-8, among the arrays
ARRAY_KEY = "$array"  # key in the document whose value is the name of an array, which replaces it
MOST_TEXT = 200  # characters of a foreign message that are shown
LARGEST = sys.float_info.max
WORD, STATE = 2**32 - 1, 2**128 - 1  # largest numbers of 32 and of 128 bits


class Stateful(Protocol):
    """Methods of an optimiser that checkpoints call."""

    def state(self) -> dict[str, Any]:
        """See `lmd.optimisers.base.Optimiser.state`."""

    def restore(self, state: Mapping[str, Any], problem: Problem) -> None:
        """See `lmd.optimisers.base.Optimiser.restore`."""


@dataclass
class Checkpoint:
    """Run that can be resumed."""

    optimiser: Stateful
    """Optimiser, which holds all of the run."""
    settings: Mapping[str, Any]
    """Flat settings, which must be equal when the run is resumed."""
    run_id: str | None = None
    """Tracked run to continue, if any."""

    def check(self) -> None:
        """Raise `InputError` if the optimiser cannot be checkpointed."""
        self._content()

    def save(self, directory: Path) -> None:
        """Replace the checkpoint in `directory`; after a crash the file is the old one or the new one.

        Raises:
            InputError: the optimiser cannot be checkpointed.
        """
        write_whole(directory / CHECKPOINT_FILE, self._content())

    def resume(self, directory: str | Path, problem: Problem) -> None:
        """Take over the state and the run of the checkpoint in `directory`.

        Args:
            directory: of the run to resume.
            problem: of the run.

        Raises:
            InputError: there is no checkpoint, it is damaged, or it was made with other settings.
        """
        path = file_path("resume", directory) / CHECKPOINT_FILE
        if not path.is_file():
            raise InputError(f"resume = {str(directory)!r} holds no {CHECKPOINT_FILE}.")
        check_memory(path.stat().st_size, f"resume = {str(directory)!r}", "resume")
        state, then, run_id = _read(path)
        now = json.loads(json.dumps(dict(self.settings)))
        for key in sorted({*now, *then}):
            if then.get(key) != now.get(key):
                raise InputError(
                    f"{path} was made with {key} = {then.get(key)!r}, not {now.get(key)!r}; resume with the same "
                    "settings."
                )
        try:
            self.optimiser.restore(state, problem)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
        except Exception as error:  # a crafted file can raise any error
            raise InputError(f"{path} cannot be gone on from ({_described(error)}).") from error
        self.run_id = run_id

    def _content(self) -> bytes:
        arrays: dict[str, Any] = {}
        with said_of(f"{type(self.optimiser).__name__} cannot be checkpointed"):
            state = _without_arrays("", self.optimiser.state(), arrays)
        document = {"format": FORMAT, "run": self.run_id, "settings": dict(self.settings), "state": state}
        arrays[DOCUMENT_KEY] = np.frombuffer(json.dumps(document).encode(), np.uint8)
        content = io.BytesIO()
        np.savez(content, **arrays)
        return content.getvalue()


def _without_arrays(name: str, value: Any, arrays: dict[str, Any]) -> Any:
    """Turn `value` into JSON with names in place of its arrays, which are added to `arrays`."""
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        arrays[f"state{name}"] = value
        return {ARRAY_KEY: f"state{name}"}
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {key: _without_arrays(f"{name}.{key}", inner, arrays) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_without_arrays(f"{name}.{i}", inner, arrays) for i, inner in enumerate(value)]
    kinds = "number, text, array of numbers, nor a list of these or a mapping from texts to them"
    raise InputError(f"its state{name} is a {type(value).__name__}, which is no {kinds}")


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Any], str | None]:
    """Read state, settings and run of a checkpoint."""
    try:
        document = _document(path)
        state, run_id = document["state"], document["run"]
        settings = json.loads(json.dumps(document["settings"]))  # fails if there are arrays among the settings
        if document["format"] != FORMAT or not isinstance(state, dict) or not isinstance(settings, dict):
            raise ValueError("it is of another kind")
        if not all(map(str.isprintable, settings)):
            raise ValueError("a setting has no such name")
        if run_id is not None and not (isinstance(run_id, str) and run_id.isalnum()):
            raise ValueError("the tracked run has no such name")
    except Exception as error:  # a damaged or crafted file can raise any error
        raise InputError(f"{path} is damaged, or no checkpoint of this version ({_described(error)}).") from error
    return state, settings, run_id


def _document(path: Path) -> Any:
    size = path.stat().st_size
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        # Otherwise a small file could claim all memory.
        if any(m.compress_type != zipfile.ZIP_STORED for m in members) or sum(m.file_size for m in members) > size:
            raise ValueError("it is compressed")
    with np.load(path, allow_pickle=False) as archive:
        arrays = dict(archive)

    def with_arrays(mapping: dict[str, Any]) -> Any:
        return arrays[mapping[ARRAY_KEY]] if ARRAY_KEY in mapping else mapping

    return json.loads(bytes(arrays.pop(DOCUMENT_KEY)), object_hook=with_arrays)


def _described(error: Exception) -> str:
    """Text of an error, which may have words from the file."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:MOST_TEXT]}"


def array(
    name: str,
    value: Any,
    dtype: DTypeLike,
    *shape: int | None,
    low: float | FloatArray = -LARGEST,
    high: float | FloatArray = LARGEST,
) -> np.ndarray:
    """Return `value` if it is an array of this type and shape (None: any length), with values in [low, high].

    Raises:
        InputError: it is something else, or has a value that is NaN or out of range.
    """
    wanted = f"{np.dtype(dtype)} of shape ({', '.join('N' if size is None else str(size) for size in shape)})"
    if not isinstance(value, np.ndarray):
        raise InputError(f"{name} must be {wanted}, got a {type(value).__name__}.", name)
    fits = value.ndim == len(shape) and all(s in (None, n) for s, n in zip(shape, value.shape, strict=True))
    if value.dtype != dtype or not fits:
        raise InputError(f"{name} must be {wanted}, got {value.dtype} of shape {value.shape}.", name)
    if (wrong := value[~((low <= value) & (value <= high))]).size:
        raise InputError(f"{name} must not have the value {wrong[0]}.", name)
    return value


def generator_state(rng: np.random.Generator) -> dict[str, Any]:
    """Return a generator as data.

    Raises:
        InputError: it was not made by `numpy.random.default_rng`.
    """
    state = dict(rng.bit_generator.state)
    if state["bit_generator"] != "PCG64":
        raise InputError(f"only generators of numpy.random.default_rng are kept, not a {state['bit_generator']}")
    return state


def generator(name: str, state: Mapping[str, Any]) -> np.random.Generator:
    """Make the generator with the `generator_state` of another.

    Raises:
        InputError: `state` is not one.
    """
    inner, rng = state["state"], np.random.default_rng(0)
    rng.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {key: integer(f"{name}.{key}", inner[key], low=0, high=STATE) for key in ("state", "inc")},
        "has_uint32": integer(f"{name}.has_uint32", state["has_uint32"], low=0, high=1),
        "uinteger": integer(f"{name}.uinteger", state["uinteger"], low=0, high=WORD),
    }
    return rng


def deployment_state(deployment: Deployment) -> dict[str, Any]:
    """Return a deployment as data, without its labels, which the problem has (`Problem.labelled`)."""
    return {name: getattr(deployment, name) for name in HUNG}


def deployment(name: str, state: Mapping[str, Any], problem: Problem, count: int) -> Deployment:
    """Make the deployment with the `deployment_state` of another.

    Args:
        name: for messages.
        state: of the other deployment.
        problem: gives the room, on whose surfaces the landmarks hang.
        count: number of landmarks.

    Raises:
        InputError: `state` is not one, or of another room.
    """
    last = len(problem.scene.plates.hanging.surfaces()) - 1
    surfaces = array(f"{name}.surfaces", state["surfaces"], np.int64, count, low=0, high=last)
    normals = array(f"{name}.normals", state["normals"], np.float64, count, 3, low=-1.5, high=1.5)
    return Deployment(points(f"{name}.positions", state["positions"], problem, count), normals, surfaces)


def points(name: str, value: Any, problem: Problem, count: int) -> FloatArray:
    """Return `value` if it holds points `(count, 3)` in the box around a problem's room and fixed tags, metres.

    Raises:
        InputError: it does not.
    """
    fixed = np.empty((0, 3)) if problem.fixed is None else problem.fixed.positions
    corners = np.vstack([*problem.scene.room.bounds(), fixed])
    low, high = corners.min(axis=0), corners.max(axis=0)
    return array(name, value, np.float64, count, 3, low=low - NEAR_SURFACE, high=high + NEAR_SURFACE)
