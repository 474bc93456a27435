"""What makes a function of a configuration a command: composing, being told to stop, sweeps, bad input."""

import atexit
import gc
import importlib.util
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from itertools import pairwise
from pathlib import Path

import hydra
from hydra._internal.hydra import Hydra
from omegaconf import DictConfig

from .app import CONF, GARBAGE, PACKAGE, command_of, ends_reported
from .fixed import PATH, quoted
from .hyperparameters import HELP, over_defaults
from .operations.signals import Stopped, stop
from .operations.sweeps import search  # noqa: F401 # from here on Hydra knows this sweeper
from .operations.sweeps.supervisor import run
from .spelling import ask_what_was_meant

# Launchers of Hydra that others wrote, and the extra's package that has each.
LAUNCHERS = {
    "joblib": "hydra_plugins.hydra_joblib_launcher",
    **dict.fromkeys(("slurm", "submitit_local", "submitit_slurm"), "hydra_plugins.hydra_submitit_launcher"),
}


# What commands that work on no run's problem take in place of `run=DIR`.
INSTEAD = {
    "estimate_pdf": "recording.path=FILE is the recording to estimate from",
    "report": "sweeps=[ID,...] chooses among the sweeps of the tracking store",
    "runs": "resume=ID goes on with one of the runs that it lists",
    "sync": "folder=DIR hands in what runs below a folder have kept",
}


def with_file(arguments: list[str], pipeline: str) -> list[str]:
    """The command line with `deployment=file` before a `deployment.path` that nothing else chooses an option for."""
    keys = [argument.partition("=")[0].lstrip("+") for argument in arguments]
    chosen = {"deployment", "deployments", "run"}.intersection(keys)
    if PATH not in keys or chosen or "- deployment:" not in Path(CONF, f"{pipeline}.yaml").read_text(encoding="utf-8"):
        return arguments
    place = keys.index(PATH)
    plain = [argument.lstrip("+") if key == PATH else argument for key, argument in zip(keys, arguments, strict=True)]
    return [*plain[:place], "deployment=file", *plain[place:]]


def _refuse_run(pipeline: str) -> None:
    """Say what a command that takes no `run=DIR` takes instead."""
    if pipeline in INSTEAD and any(argument.startswith("run=") for argument in sys.argv[1:]):
        sys.exit(f"error: run is no key of {pipeline}: {INSTEAD[pipeline]}.")


def _refuse_launcher_that_is_missing() -> None:
    """Say what is missing before Hydra says only that it knows no such launcher."""
    for argument in sys.argv[1:]:
        name = argument.removeprefix("+").removeprefix("hydra/launcher=")
        if name in LAUNCHERS and name != argument and not _is_installed(LAUNCHERS[name]):
            from lmd.core.optional import missing

            sys.exit(f"error: {missing(LAUNCHERS[name], 'sweeps')}")


def _is_installed(package: str) -> bool:
    try:
        return importlib.util.find_spec(package) is not None
    except ModuleNotFoundError:  # nor is what it is a part of
        return False


@dataclass(frozen=True)
class _Experiment:
    """An experiment that its file does not name for the command it was given to.

    Args:
        name: of the experiment.
        commands: which the file names.
        is_sweep: whether it is a stored sweep.
    """

    name: str
    commands: tuple[str, ...]
    is_sweep: bool

    def __str__(self) -> str:
        given = " or ".join(f"{command_of(command)} experiment={self.name}" for command in self.commands)
        return f"experiment={self.name} is for another command: {given}"


def _experiment_of_another(pipeline: str) -> _Experiment | None:
    """The experiment on the command line, if it comes with the project and its file names other commands alone."""
    given = [argument.partition("=")[2] for argument in sys.argv[1:] if argument.startswith("experiment=")]
    file = Path(CONF, "experiment", f"{given[-1]}.yaml") if given else None
    if file is None or not file.is_file():
        return None
    text = file.read_text(encoding="utf-8")
    commands = tuple(dict.fromkeys(re.findall(rf"-m pipelines\.(\w+) experiment={re.escape(file.stem)}\b", text)))
    return _Experiment(file.stem, commands, "mode: MULTIRUN" in text) if commands and pipeline not in commands else None


def _refuse_configuration_of_another(pipeline: str) -> None:
    """Exit where `--config-name` names the configuration of another command."""
    words = [word for argument in sys.argv[1:] for word in argument.split("=", 1)]
    for option, name in pairwise(words):
        named = name.removesuffix(".yaml")
        if option not in ("--config-name", "-cn") or named == pipeline or not named.isidentifier():
            continue
        if Path(CONF, f"{named}.yaml").is_file() and Path(__file__).with_name(f"{named}.py").is_file():
            sys.exit(f"error: --config-name {name} is the configuration of another command: {command_of(named)}")


Task = Callable[[DictConfig], float | None]


def alone(cfg: DictConfig, task: Task) -> float | None:
    """Call a task that is no job of a sweep, and report what it raises."""
    with ends_reported():
        return task(cfg)


@dataclass(frozen=True)
class Pipeline:
    """A command: a task whose configuration is composed from the command line, and which can be told to stop.

    Args:
        name: of the command, of its module and of its configuration: `optimise` and so on.
        task: called with the configuration.
        prepare: called one after the other before Hydra reads the command line, which they may change.
        runner: calls the task and reports what it raises. By default a sweep runs each job in a process of its own.
    """

    name: str
    task: Task
    prepare: tuple[Callable[[], None], ...] = ()
    runner: Callable[[DictConfig, Task], float | None] = run

    def __call__(self) -> None:
        """Do what the command line says."""
        sys.argv[1:] = with_file(sys.argv[1:], self.name)
        for change in self.prepare:
            change()
        gc.set_threshold(GARBAGE)
        sys.argv[1:] = [over_defaults(quoted(argument)) for argument in sys.argv[1:]]
        if HELP.intersection(sys.argv):
            sys.argv.append("hydra.help.template=${lmd.help:}")
            # For another template Hydra would read all files twice, which is most of what it takes.
            Hydra.format_config_groups = lambda *_: ""  # type: ignore[method-assign]
        _refuse_configuration_of_another(self.name)
        _refuse_launcher_that_is_missing()
        _refuse_run(self.name)
        experiment = _experiment_of_another(self.name)
        if experiment is not None and experiment.is_sweep:  # of which each job would fail, or do something else
            sys.exit(f"error: {experiment}.")

        is_composed = False

        @wraps(self.task)
        def run_composed(cfg: DictConfig) -> float | None:
            nonlocal is_composed
            is_composed = True
            return self.runner(cfg, self.task)

        run_composed.__module__ = f"{PACKAGE}.{self.name}"  # names Hydra's job, also where the module is __main__
        compose = hydra.main(version_base="1.3", config_path=CONF, config_name=self.name)
        atexit.register(gc.freeze)  # Python looks for garbage once more when it ends: with mlflow, for a second
        try:
            with stop.raising():
                compose(run_composed)()
        except Stopped as told:
            sys.exit(told.code)
        except SystemExit as ended:
            if ended.code and not is_composed:
                ask_what_was_meant(CONF)
                if experiment is not None:
                    print(experiment, file=sys.stderr)
            raise
