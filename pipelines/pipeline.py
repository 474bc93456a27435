"""Command: a function of a configuration composed from the command line, which stops on a signal and may sweep."""

import atexit
import gc
import re
import signal
import sys
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import wraps
from itertools import pairwise
from pathlib import Path

import hydra
from hydra._internal.hydra import Hydra
from omegaconf import DictConfig

from .app import CONF, GARBAGE, PACKAGE, command_of, ends_reported, readers_outlived
from .frozen import offer_frozen_problems
from .hyperparameters import HELP
from .operations.signals import Stopped, stop
from .operations.sweeps.supervisor import run
from .outputs import locks
from .overrides import PATH, as_hydra_reads, ask_what_was_meant, forced, offer_file_formats

# Launchers that are plugins of Hydra, and their packages.
LAUNCHERS = {
    "joblib": "hydra_plugins.hydra_joblib_launcher",
    **dict.fromkeys(("submitit_local", "submitit_slurm"), "hydra_plugins.hydra_submitit_launcher"),
}
PRINTED = {*HELP, "--hydra-help", "--cfg", "-c", "--info", "-i"}  # options with which a command only prints
# Commands without `run=DIR`, and the key to use instead.
INSTEAD = {
    "estimate_pdf": "recording.path=FILE is the recording to estimate from",
    "report": "sweeps=[ID,...] chooses among the sweeps of the tracking store",
    "runs": "resume=ID goes on with one of the runs that it lists",
    "sync": "folder=DIR hands in what runs below a folder have kept",
}


def with_file(arguments: list[str], pipeline: str) -> list[str]:
    """Command line with `deployment=file` added before a `deployment.path`, unless an option of the group is chosen."""
    keys = [argument.partition("=")[0].lstrip("+") for argument in arguments]
    chosen = {"deployment", "deployments", "run"}.intersection(keys)
    if PATH not in keys or chosen or "- deployment:" not in Path(CONF, f"{pipeline}.yaml").read_text(encoding="utf-8"):
        return arguments
    place = keys.index(PATH)
    plain = [argument.lstrip("+") if key == PATH else argument for key, argument in zip(keys, arguments, strict=True)]
    return [*plain[:place], "deployment=file", *plain[place:]]


def _refuse_run(pipeline: str) -> None:
    """Exit if `run=DIR` is given to a command that does not accept it."""
    if pipeline in INSTEAD and any(argument.startswith("run=") for argument in sys.argv[1:]):
        sys.exit(f"error: run is no key of {pipeline}: {INSTEAD[pipeline]}.")


def _refuse_launcher_that_is_missing() -> None:
    """Exit if the package of a launcher is missing, with a better message than Hydra's."""
    for argument in sys.argv[1:]:
        name = argument.removeprefix("+").removeprefix("hydra/launcher=")
        if name in LAUNCHERS and name != argument:
            from lmd.core.checks import InputError
            from lmd.core.optional import optional

            try:
                optional(LAUNCHERS[name], "sweeps")
            except InputError as error:
                sys.exit(f"error: {error}")


def _experiment_of_another(pipeline: str) -> tuple[str, bool]:
    """Sentence about the experiment on the command line if its file, which is part of the project, names only other
    commands, else an empty text; and True for a stored sweep.
    """
    given = [argument.partition("=")[2] for argument in sys.argv[1:] if argument.startswith("experiment=")]
    file = Path(CONF, "experiment", f"{given[-1]}.yaml") if given else None
    if file is None or not file.is_file():
        return "", False
    text, chosen = file.read_text(encoding="utf-8"), f"experiment={file.stem}"
    commands = dict.fromkeys(re.findall(rf"-m pipelines\.(\w+) {re.escape(chosen)}\b", text))
    if not commands or pipeline in commands:
        return "", False
    right = " or ".join(f"{command_of(command)} {chosen}" for command in commands)
    return f"{chosen} is for another command: {right}", "mode: MULTIRUN" in text


def _refuse_configuration_of_another(pipeline: str) -> None:
    """Exit if `--config-name` names the configuration of another command."""
    words = [word for argument in sys.argv[1:] for word in argument.split("=", 1)]
    for option, name in pairwise(words):
        named = name.removesuffix(".yaml")
        if option not in ("--config-name", "-cn") or named == pipeline or not named.isidentifier():
            continue
        if Path(CONF, f"{named}.yaml").is_file() and Path(__file__).with_name(f"{named}.py").is_file():
            sys.exit(f"error: --config-name {name} is the configuration of another command: {command_of(named)}")


Task = Callable[[DictConfig], float | None]


def alone(cfg: DictConfig, task: Task) -> float | None:
    """Call a task that cannot be a job of a sweep, and report an error."""
    with ends_reported():
        return task(cfg)


@dataclass(frozen=True)
class Pipeline:
    """Command that is called without arguments."""

    name: str
    """Name of the command, of its module and of its configuration, such as `optimise`."""
    task: Task
    """Function that is called with the configuration."""
    prepare: tuple[Callable[[], None], ...] = ()
    """Functions that are called in turn before Hydra reads the command line, and that may change the command line."""
    runner: Callable[[DictConfig, Task], float | None] = run
    """Function that calls the task and reports an error; by default each job of a sweep gets a process of its own."""

    def __call__(self) -> None:
        """Run the command line of this process."""
        sys.argv[1:] = with_file(sys.argv[1:], self.name)
        try:
            offer_frozen_problems(self.name, sys.argv[1:])
        except ValueError as error:
            sys.exit(f"error: {error}")
        for change in self.prepare:
            change()
        gc.set_threshold(GARBAGE)
        sys.argv[1:] = forced(list(map(as_hydra_reads, sys.argv[1:])))
        if HELP.intersection(sys.argv):
            sys.argv.append("hydra.help.template=${lmd.help:}")
            # Hydra's own template would read all files twice.
            Hydra.format_config_groups = lambda *_: ""  # type: ignore[method-assign]
        if PRINTED.intersection(argument.partition("=")[0] for argument in sys.argv):
            signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # ends quietly if the reader, such as `head`, has ended
        _refuse_configuration_of_another(self.name)
        _refuse_launcher_that_is_missing()
        _refuse_run(self.name)
        experiment, is_sweep = _experiment_of_another(self.name)
        if is_sweep:  # each job would fail, or compute something else
            sys.exit(f"error: {experiment}.")

        is_composed = False

        @wraps(self.task)
        def run_composed(cfg: DictConfig) -> float | None:
            nonlocal is_composed
            is_composed = True
            offer_file_formats()
            return self.runner(cfg, self.task)

        run_composed.__module__ = f"{PACKAGE}.{self.name}"  # Hydra names the job after this module
        compose = hydra.main(version_base="1.3", config_path=CONF, config_name=self.name)
        atexit.register(gc.freeze)  # otherwise the last garbage collection takes a second with mlflow
        try:
            with stop.raising(), readers_outlived(), closing(locks):
                compose(run_composed)()
        except Stopped as told:
            sys.exit(told.code)
        except SystemExit as ended:
            if ended.code == 1 and not is_composed:  # Hydra has refused the command line
                ask_what_was_meant()
                if experiment:
                    print(experiment, file=sys.stderr)
            raise
