"""Checkpoints: files from which a stopped run is resumed.

A checkpoint holds data and no code: an optimiser that is made from the configuration continues from the state in the
file. The file is a NumPy archive with the arrays and a JSON document; nothing is unpickled.
"""

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import InputError, file_path, said_of
from lmd.core.files import write_whole
from lmd.core.memory import check_memory
from lmd.optimisers.base import Optimiser
from lmd.problem import Problem

CHECKPOINT_FILE = "checkpoint.npz"
FORMAT = "lmd checkpoint 5"  # the number changes when the content of the file changes
DOCUMENT_KEY = "document"  # name of the JSON document, UTF-8, among the arrays
ARRAY_KEY = "$array"  # only key of a mapping that stands for an array in the document; its value names the array
MOST_TEXT = 200  # greatest number of characters shown of an error of another library


@dataclass
class Checkpoint:
    """Content of a checkpoint: the optimiser and the settings of a run that can be stopped and resumed."""

    optimiser: Optimiser
    """Optimiser, which holds the whole state of the run."""
    settings: Mapping[str, Any]
    """Settings, keyed by config key, which must be equal when the run is resumed."""
    run_id: str | None = None
    """Id of the tracked run that is continued; None for none."""

    def check(self) -> None:
        """Raise `InputError` if the optimiser cannot be checkpointed."""
        self._content()

    def save(self, directory: Path) -> None:
        """Replace the checkpoint in `directory`; even after a crash, there is a complete file, either the old or the
        new one.

        Raises:
            InputError: the optimiser cannot be checkpointed.
        """
        write_whole(directory / CHECKPOINT_FILE, self._content())

    def resume(self, directory: str | Path, problem: Problem) -> None:
        """Set the state of `optimiser`, and `run_id`, to those of the checkpoint in `directory`.

        Args:
            directory: directory of the run to resume.
            problem: problem of the run.

        Raises:
            InputError: there is no checkpoint, or it is damaged or was made with other settings.
        """
        path = file_path("resume", directory) / CHECKPOINT_FILE
        if not path.is_file():
            raise InputError(f"resume = {str(directory)!r} holds no {CHECKPOINT_FILE}: name another run.")
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
            raise InputError(f"{path} cannot be resumed ({_described(error)}).") from error
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
    """Copy of `value`, a part of an optimiser's state, without arrays, so that it can be written as JSON.

    Each array is replaced by a name, and is added to `arrays` under this name. `name` is the path of `value` within the
    state, for example `.best.positions`.
    """
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
    kinds = "number, a text or an array of numbers, nor a list or mapping of these"
    raise InputError(f"its state{name} is a {type(value).__name__}, which is neither a {kinds}")


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Any], str | None]:
    """Read a checkpoint; return the optimiser's state, the settings, and the id under which the run is tracked."""
    try:
        document = _document(path)
        state, run_id = document["state"], document["run"]
        settings = json.loads(json.dumps(document["settings"]))  # fails if the settings contain arrays
        if document["format"] != FORMAT or not isinstance(state, dict) or not isinstance(settings, dict):
            raise ValueError("it has another format")
        if not all(map(str.isprintable, settings)):
            raise ValueError("a setting has an invalid name")
        if run_id is not None and not (isinstance(run_id, str) and run_id.isalnum()):
            raise ValueError("the tracked run has an invalid name")
    except Exception as error:  # a damaged or crafted file can raise any error
        raise InputError(f"{path} is damaged, or is not a checkpoint of this version ({_described(error)}).") from error
    return state, settings, run_id


def _document(path: Path) -> Any:
    size = path.stat().st_size
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        # Compressed members are refused: a small file could fill the memory.
        if any(m.compress_type != zipfile.ZIP_STORED for m in members) or sum(m.file_size for m in members) > size:
            raise ValueError("it is compressed")
    with np.load(path, allow_pickle=False) as archive:
        arrays = dict(archive)

    def with_arrays(mapping: dict[str, Any]) -> Any:
        return arrays[mapping[ARRAY_KEY]] if ARRAY_KEY in mapping else mapping

    return json.loads(bytes(arrays.pop(DOCUMENT_KEY)), object_hook=with_arrays)


def _described(error: Exception) -> str:
    """Return the type and the message of an error as one line of text, cut to `MOST_TEXT` characters."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:MOST_TEXT]}"
