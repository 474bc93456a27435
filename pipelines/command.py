"""Commands of the project.

A command is a function that Hydra calls with a composed configuration; it stops on a signal, and can run as a sweep.
"""

import atexit
import gc
import os
import signal
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from functools import wraps
from typing import Any

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from .app import CONF, PACKAGE, command_of, spelled
from .composing import settled
from .operations.signals import Stopped, stop
from .operations.sweeps.supervisor import run
from .outputs import locks
from .study import Study, conduct
from .trust import Trust

HELP = ("--help", "-h")
PRINTED = {*HELP, "--hydra-help", "--cfg", "-c", "--info", "-i"}  # options with which a command only prints


@dataclass(frozen=True)
class Command:
    """Command of the project; calling the object without arguments runs the command."""

    name: str
    """Name of the command, which is also the name of its module and of its configuration, such as `optimise`."""
    task: Callable[[DictConfig], Study | float | None]
    """Function that is called with the configuration; if it returns a study, the study is then conducted."""
    like: str = ""
    """Name of another command, whose configuration this command uses with the changes in `settings`; for commands
    outside of this package. Empty if the command has a configuration of its own.
    """
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Keys and default values that are added to the configuration of the command `like`."""

    def __call__(self) -> None:
        """Run the command with the command line of this process."""
        if self.like:
            stop.listen()
            node = {"defaults": [self.like, "_self_"], **self.settings, "hydra": {"job": {"name": self.name}}}
            ConfigStore.instance().store(self.name, node)
        if PRINTED.intersection(argument.partition("=")[0] for argument in sys.argv):
            signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # end quietly if the reader, such as `head`, has ended
        if len(options := [word for word in sys.argv[1:] if word.startswith("-")]) == 1 and options[0] in HELP:
            print(help_of(self.name, [word for word in sys.argv[1:] if word not in HELP]))
            return

        def settle_and_do(cfg: DictConfig) -> float | None:
            final = settled(cfg)
            outcome = self.task(final)
            return conduct(final, outcome) if isinstance(outcome, Study) else outcome

        @wraps(self.task)
        def run_composed(cfg: DictConfig) -> float | None:
            offer_file_formats()
            return run(cfg, settle_and_do)

        run_composed.__module__ = f"{PACKAGE}.{self.name}"  # Hydra names the job after the module of this function
        compose = hydra.main(version_base="1.3", config_path=CONF, config_name=self.name)
        atexit.register(gc.freeze)  # otherwise the last garbage collection takes a second if mlflow is imported
        try:
            with stop.raising(), closing(locks):
                compose(run_composed)()
        except Stopped as told:
            sys.exit(told.code)


def help_of(command: str, overrides: Iterable[str]) -> str:
    """Text of `--help` for a command with the given overrides: each config group, with the options of the group."""
    from hydra import compose as by_hydra
    from hydra import initialize_config_dir

    with initialize_config_dir(CONF, version_base="1.3"):
        composed = by_hydra(command, list(map(spelled, overrides)), return_hydra_config=True)
    picked = {str(group).partition("@")[0] for group in composed.hydra.runtime.choices} | {*map(str, composed)}
    options: dict[str, set[str]] = {}
    for file in (file for at in Trust.of(composed, composed.hydra.runtime).folders for file in at.glob("*/*.yaml")):
        options.setdefault(file.parent.name, set()).add(file.stem)
    groups = [f"{group}: {', '.join(sorted(options[group]))}" for group in sorted(options) if group in picked]
    usage = f"{command_of(command)} [group=option] [key=value]"
    return "\n".join([usage, "", *groups, "", "--cfg job shows the keys that are set, -m makes a sweep."])


def offer_file_formats() -> None:
    """Let `lmd.formats.registry` also read the folders `file_formats` on Hydra's search path.

    This holds for this process and for processes that it starts.
    """
    sources = HydraConfig.get().runtime.config_sources
    folders = [os.path.join(source.path, "file_formats") for source in sources if source.schema == "file"]
    known = filter(None, os.environ.get("LMD_FORMATS", "").split(os.pathsep))
    os.environ["LMD_FORMATS"] = os.pathsep.join(dict.fromkeys([*known, *filter(os.path.isdir, folders)]))
