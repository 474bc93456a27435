"""Checkpoints: a stopped run goes on where it was."""

import os
import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lmd.checks import InputError
from lmd.optimisers.base import Optimiser

FILE = "checkpoint.pkl"


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
    run_id: str | None

    def save(self, directory: Path) -> None:
        """Replace the checkpoint in `directory`; a crash leaves the old one or the new one, never half of one."""
        partial = directory / f"{FILE}.partial"
        partial.write_bytes(pickle.dumps(self))
        os.replace(partial, directory / FILE)

    @classmethod
    def load(cls, directory: str | Path, settings: Mapping[str, Any]) -> "Checkpoint":
        """Read the checkpoint in `directory`. It is a pickle: load only what you trust.

        Raises:
            InputError: there is none, it cannot be read, or it was made with other settings.
        """
        path = Path(directory) / FILE
        if not path.is_file():
            raise InputError(f"resume = {str(directory)!r} holds no {FILE}.")
        try:
            checkpoint = pickle.loads(path.read_bytes())
        except Exception as error:  # unpickling damaged bytes can raise anything
            raise InputError(f"{path} cannot be read ({type(error).__name__}: {error}).") from error
        if not isinstance(checkpoint, cls):
            raise InputError(f"{path} is not a checkpoint.")
        keys = {*settings, *checkpoint.settings}
        for key in sorted(keys):
            then, now = checkpoint.settings.get(key), settings.get(key)
            if then != now:
                raise InputError(f"{path} was made with {key} = {then!r}, not {now!r}; resume with the same settings.")
        return checkpoint
