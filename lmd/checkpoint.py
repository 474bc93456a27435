"""Checkpoints: a stopped run goes on where it was.

A checkpoint holds data and no code: the optimiser is made by who resumes, and takes over the state that is read. The
file is a pickle behind a checksum. The checksum tells damage; what keeps a file that was tampered with from running
code is that only classes of `lmd` and of the optimiser's own package, and what numpy's arrays and generators are made
of, can be named in it.
"""

import hashlib
import io
import os
import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lmd.checks import InputError, file_path
from lmd.optimisers.base import Optimiser

FILE = "checkpoint.pkl"
HEADER = b"lmd checkpoint 2\n"  # a number for each way of writing it
CHECKSUM = hashlib.sha256
# What pickled arrays, numbers and generators of numpy call.
NUMPY = {
    "numpy": {"dtype", "ndarray"},
    "numpy._core.multiarray": {"_reconstruct", "scalar"},
    "numpy._core.numeric": {"_frombuffer"},
    "numpy.random._pickle": {"__bit_generator_ctor", "__generator_ctor", "__randomstate_ctor"},
    "numpy.random._mt19937": {"MT19937"},
    "numpy.random._pcg64": {"PCG64", "PCG64DXSM"},
    "numpy.random._philox": {"Philox"},
    "numpy.random._sfc64": {"SFC64"},
    "numpy.random.bit_generator": {"SeedSequence", "__pyx_unpickle_SeedSequence"},
}


@dataclass
class Checkpoint:
    """A run that can be resumed.

    Args:
        optimiser: the optimiser with everything it needs to go on.
        settings: flat settings that must be the same when the run goes on.
        run_id: the tracked run to continue, if any.
    """

    optimiser: Optimiser
    settings: Mapping[str, Any]
    run_id: str | None = None

    def save(self, directory: Path) -> None:
        """Replace the checkpoint in `directory`; a crash leaves the old one or the new one, never half of one."""
        content = pickle.dumps((self.optimiser.state(), dict(self.settings), self.run_id))
        partial = directory / f"{FILE}.partial"
        try:
            partial.write_bytes(HEADER + CHECKSUM(content).digest() + content)
            os.replace(partial, directory / FILE)
        except OSError:
            partial.unlink(missing_ok=True)
            raise

    def resume(self, directory: str | Path) -> None:
        """Take over the state and the run of the checkpoint in `directory`.

        Raises:
            InputError: there is none, it is damaged or holds what it may not, or it was made with other settings.
        """
        path = file_path("resume", directory) / FILE
        if not path.is_file():
            raise InputError(f"resume = {str(directory)!r} holds no {FILE}.")
        state, then, run_id = _read(path, {"lmd", _package(type(self.optimiser).__module__)})
        for key in sorted({*self.settings, *then}):
            if then.get(key) != self.settings.get(key):
                raise InputError(
                    f"{path} was made with {key} = {then.get(key)!r}, not {self.settings.get(key)!r}; resume with the "
                    "same settings."
                )
        self.optimiser.restore(state)
        self.run_id = run_id


def _read(path: Path, packages: set[str]) -> tuple[dict[str, Any], dict[str, Any], str | None]:
    """State, settings and run of a checkpoint whose classes are of these packages."""
    begin = len(HEADER) + CHECKSUM().digest_size
    read = path.read_bytes()
    if not read.startswith(HEADER):
        raise InputError(f"{path} is not a checkpoint of this version.")
    if CHECKSUM(read[begin:]).digest() != read[len(HEADER) : begin]:
        raise InputError(f"{path} is damaged: its checksum does not match what it holds.")
    try:
        state, settings, run_id = _Unpickler(io.BytesIO(read[begin:]), packages).load()
    except Exception as error:  # what was written on purpose can raise anything
        raise InputError(f"{path} cannot be read ({type(error).__name__}: {error}).") from error
    return state, settings, run_id


class _Unpickler(pickle.Unpickler):
    """Reads data: of all that a pickle can name, only what is known to do no more than to hold it.

    Args:
        file: of bytes.
        packages: whose own classes may be named.
    """

    def __init__(self, file: io.BytesIO, packages: set[str]) -> None:
        super().__init__(file)
        self._packages = packages

    def find_class(self, module: str, name: str) -> Any:
        """What a pickle calls, by its name."""
        if name in NUMPY.get(module, ()):
            return super().find_class(module, name)
        if _package(module) in self._packages and name.isidentifier():
            found = super().find_class(module, name)
            if isinstance(found, type) and found.__module__ == module:  # and nothing that the module has imported
                return found
        raise pickle.UnpicklingError(
            f"it names {module}.{name}, which is neither numpy's nor a class of {' or '.join(sorted(self._packages))}"
        )


def _package(module: str) -> str:
    return module.partition(".")[0]
