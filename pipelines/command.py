"""Command: a function of a configuration that Hydra composes; it stops on a signal, and may sweep."""

import atexit
import gc
import os
import re
import signal
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import Any

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from .app import CONF, PACKAGE, choices, command_of, ends_reported
from .composing import settled
from .operations.signals import Stopped, stop
from .operations.sweeps.supervisor import SWEEP_VARIABLE, run
from .outputs import locks
from .overrides import ask_what_was_meant, spelled
from .study import Study, conduct
from .trust import Trust

HELP = ("--help", "-h")
# Launchers that are plugins of Hydra, and their packages.
LAUNCHERS = {
    "joblib": "hydra_plugins.hydra_joblib_launcher",
    **dict.fromkeys(("submitit_local", "submitit_slurm"), "hydra_plugins.hydra_submitit_launcher"),
}
PRINTED = {*HELP, "--hydra-help", "--cfg", "-c", "--info", "-i"}  # options with which a command only prints
Outcome = Study | float | None
Task = Callable[[DictConfig], Outcome]


def alone(cfg: DictConfig, task: Callable[[DictConfig], float | None]) -> float | None:
    """Call a task that cannot be a job of a sweep, and report an error."""
    with ends_reported():
        return task(cfg)


@dataclass(frozen=True)
class Command:
    """Command that is called without arguments."""

    name: str
    """Name of the command, of its module and of its configuration, such as `optimise`."""
    task: Task
    """Function of the configuration; a study that it returns is conducted."""
    runner: Callable[[DictConfig, Callable[[DictConfig], float | None]], float | None] = run
    """Function that calls the task and reports an error; by default each job of a sweep gets a process of its own."""
    like: str = ""
    """Command whose configuration it has, beside `settings`; for commands outside of this package."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Further keys of its configuration, with their defaults."""

    def __call__(self) -> None:
        """Run the command line of this process."""
        if self.like:
            stop.listen()
            node = {"defaults": [self.like, "_self_"], **self.settings, "hydra": {"job": {"name": self.name}}}
            ConfigStore.instance().store(self.name, node)
        if PRINTED.intersection(argument.partition("=")[0] for argument in sys.argv):
            signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # ends quietly if the reader, such as `head`, has ended
        if len(options := [word for word in sys.argv[1:] if word.startswith("-")]) == 1 and options[0] in HELP:
            print(help_of(self.name, [word for word in sys.argv[1:] if word not in HELP]))
            return
        _check_launcher()
        is_composed = False

        def settle_and_do(cfg: DictConfig) -> float | None:
            _check_experiment(self.name)
            final = settled(cfg)
            outcome = self.task(final)
            return conduct(final, outcome) if isinstance(outcome, Study) else outcome

        @wraps(self.task)
        def run_composed(cfg: DictConfig) -> float | None:
            nonlocal is_composed
            is_composed = True
            offer_file_formats()
            return self.runner(cfg, settle_and_do)

        run_composed.__module__ = f"{PACKAGE}.{self.name}"  # Hydra names the job after this module
        compose = hydra.main(version_base="1.3", config_path=CONF, config_name=self.name)
        atexit.register(gc.freeze)  # otherwise the last garbage collection takes a second with mlflow
        try:
            with stop.raising(), closing(locks):
                compose(run_composed)()
        except Stopped as told:
            sys.exit(told.code)
        except SystemExit as ended:
            if ended.code == 1 and not is_composed and SWEEP_VARIABLE not in os.environ:  # Hydra has refused it
                ask_what_was_meant()
            raise


def _check_launcher() -> None:
    """Exit if the package of a launcher is missing, with a sentence in place of Hydra's lines."""
    from lmd.core.checks import InputError
    from lmd.core.optional import optional

    names = [word.removeprefix("+").partition("hydra/launcher=")[2] for word in sys.argv[1:]]
    try:
        for name in LAUNCHERS.keys() & names:
            optional(LAUNCHERS[name], "sweeps")
    except InputError as error:
        sys.exit(f"error: {error}")


def help_of(command: str, overrides: Iterable[str]) -> str:
    """Text of `--help`: a line for each group that a command composes, with its options."""
    from hydra import compose as by_hydra
    from hydra import initialize_config_dir

    with initialize_config_dir(CONF, version_base="1.3"):
        composed = by_hydra(command, list(map(spelled, overrides)), return_hydra_config=True)
    picked = {str(group).partition("@")[0] for group in composed.hydra.runtime.choices} | {*map(str, composed)}
    options: dict[str, set[str]] = {}
    for file in (file for folder in Trust.given().folders for file in folder.glob("*/*.yaml")):
        options.setdefault(file.parent.name, set()).add(file.stem)
    groups = [f"{group}: {', '.join(sorted(options[group]))}" for group in sorted(options) if group in picked]
    usage = f"{command_of(command)} [group=option] [key=value]"
    return "\n".join([usage, "", *groups, "", "--cfg job shows the keys that are set, -m makes a sweep."])


def offer_file_formats() -> None:
    """Name the folders `file_formats` on the search path to `lmd.formats.registry`, here and in processes to come."""
    sources = HydraConfig.get().runtime.config_sources
    folders = [os.path.join(source.path, "file_formats") for source in sources if source.schema == "file"]
    known = filter(None, os.environ.get("LMD_FORMATS", "").split(os.pathsep))
    os.environ["LMD_FORMATS"] = os.pathsep.join(dict.fromkeys([*known, *filter(os.path.isdir, folders)]))


def _check_experiment(command: str) -> None:
    """Raise `InputError` if a stored sweep, which is part of the project, names only other commands."""
    from lmd.core.checks import InputError

    file = Path(CONF, "experiment", f"{choices().get('experiment')}.yaml")
    text = file.read_text(encoding="utf-8") if file.is_file() else ""
    if "mode: MULTIRUN" not in text:
        return
    known = dict.fromkeys(re.findall(rf"-m pipelines\.(\w+) .*experiment={re.escape(file.stem)}\b", text))
    if known and command not in known:
        right = " or ".join(f"{command_of(other)} experiment={file.stem}" for other in known)
        raise InputError(f"experiment={file.stem} is for another command: {right}.")
