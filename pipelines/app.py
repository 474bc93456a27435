"""What the pipelines share: where the configuration is, what was asked for, and reporting bad input."""

import atexit
import errno
import gc
import importlib.util
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf, open_dict

from .fixed import quoted
from .operations.signals import Stopped, stop
from .spelling import ask_what_was_meant

PACKAGE = str(__package__)  # `pipelines` in a checkout, `lmd.pipelines` where lmd is installed
IN_CHECKOUT = PACKAGE == "pipelines"
GARBAGE = 100_000  # objects before Python looks for garbage: at its 700, that takes a quarter of all imports
CONF = str(Path(__file__).resolve().parents[1] / "conf")  # beside this package in both


def lmd_package() -> str:
    """The name of this package, for the configuration."""
    return PACKAGE


OmegaConf.register_new_resolver("lmd.package", lmd_package, replace=True)


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


def application(config_name: str) -> Callable[[Callable[[DictConfig], object]], Callable[[], None]]:
    """Make a function of a configuration a program that composes it from the command line and can be told to stop.

    Args:
        config_name: `optimise` and so on.
    """

    def decorate(function: Callable[[DictConfig], object]) -> Callable[[], None]:
        composed = hydra.main(version_base="1.3", config_path=CONF, config_name=config_name)(function)

        @wraps(function)
        def main() -> None:
            gc.set_threshold(GARBAGE)
            sys.argv[1:] = map(quoted, sys.argv[1:])
            _refuse_launcher_that_is_missing()
            _refuse_run(config_name)
            atexit.register(gc.freeze)  # Python looks for garbage once more when it ends: with mlflow, for a second
            try:
                with stop.raising():
                    composed()
            except Stopped as told:
                sys.exit(told.code)
            except SystemExit as ended:
                if ended.code:
                    ask_what_was_meant(CONF)
                raise

        return main

    return decorate


def command_of(pipeline: str) -> str:
    """What starts a pipeline from where this one was started, for messages."""
    return f"python -m pipelines.{pipeline}" if IN_CHECKOUT else f"lmd-{pipeline.replace('_', '-')}"


def save_path(save_as: Any) -> Path | None:
    """`save_as`, whose folder is made and tried before anything has run; None for null.

    Raises:
        InputError: it is no text, or its folder cannot be written to.
    """
    from lmd.core.checks import InputError, file_path

    if save_as is None:
        return None
    path = file_path("save_as", save_as)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            return path
    except OSError as error:
        raise InputError(f"save_as = {save_as!r} cannot be written ({error}).") from None


def search_path() -> list[str]:
    """The overrides that add folders of configuration, which others depend on."""
    return [o for o in HydraConfig.get().overrides.hydra if o.startswith("hydra.searchpath=")]


def config_dir() -> list[str]:
    """The option `--config-dir` this application was started with, none for none; another process needs it too."""
    sources = HydraConfig.get().runtime.config_sources
    return [word for source in sources if source.provider == "command-line" for word in ("--config-dir", source.path)]


def task_overrides() -> list[tuple[str, str]]:
    """The overrides of this job as pairs of the key or group and the override itself."""
    from hydra.core.override_parser.overrides_parser import OverridesParser

    parsed = OverridesParser.create().parse_overrides(list(HydraConfig.get().overrides.task))
    return [(str(override.key_or_group), str(override.input_line)) for override in parsed]


def recompose(config_name: str, overrides: Sequence[str], setting: str, entry: str) -> DictConfig:
    """Another configuration of the running application, without Hydra's own part.

    Args:
        config_name: `optimise` and so on.
        overrides: its overrides, as on a command line.
        setting, entry: what asks for it, for messages.

    Raises:
        InputError: Hydra refuses the overrides.
    """
    from hydra.core.global_hydra import GlobalHydra
    from hydra.errors import HydraException

    from lmd.core.checks import InputError

    try:
        loader = GlobalHydra.instance().config_loader()
        composed = loader.load_configuration(
            config_name, [*map(quoted, overrides)], RunMode.RUN, validate_sweep_overrides=False
        )
    except HydraException as error:
        raise InputError(f"{setting}: {entry!r} is refused: {str(error).splitlines()[0]}") from error
    with open_dict(composed):
        composed.pop("hydra")
    return composed


def flat_settings(cfg: DictConfig, *keys: str) -> dict[str, Any]:
    """The resolved settings below `keys` (all by default) as `{"room.spacing": 0.5, ...}`."""
    resolved = OmegaConf.to_container(cfg, resolve=True)
    assert isinstance(resolved, dict)
    flat: dict[str, Any] = {}

    def visit(prefix: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, inner in value.items():
                visit(f"{prefix}.{key}", inner)
        else:
            flat[prefix] = value

    for key in keys or tuple(str(name) for name in resolved):
        visit(key, resolved[key])
    return flat


def run_directory() -> Path:
    """The Hydra output directory of this job."""
    return Path(HydraConfig.get().runtime.output_dir)


def choices() -> dict[str, str]:
    """The option picked in each config group, e.g. `{"room": "paper_simulation"}`."""
    picked = HydraConfig.get().runtime.choices
    return {str(k): str(v) for k, v in picked.items() if not str(k).startswith("hydra/") and v is not None}


@contextmanager
def ends_reported() -> Iterator[None]:
    """Turn bad input and a full disk into one sentence on stderr and exit code 1; bad input leaves no trace.

    Memory that is refused counts as bad input: what takes most is estimated (`lmd.core.memory`), the rest is not.
    """
    from lmd.core.checks import InputError

    try:
        with stop.raising():
            yield
            sys.stdout.flush()
    except (InputError, MemoryError) as error:
        discard_empty(run_directory())
        lack = "there is not enough memory for these settings: " if isinstance(error, MemoryError) else ""
        print(f"error: {lack}{error}", file=sys.stderr)
        sys.exit(1)
    except BrokenPipeError:  # whoever read what is printed, such as `head`, has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        sys.exit(128 + signal.SIGPIPE)
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        print(f"error: {error.filename or run_directory()}: {error.strerror}", file=sys.stderr)
        sys.exit(1)


def discard_empty(directory: Path) -> None:
    """Remove the directory of a run if nothing came of it."""
    if directory.is_dir() and {path.name for path in directory.iterdir()} <= {".hydra"}:
        shutil.rmtree(directory)
