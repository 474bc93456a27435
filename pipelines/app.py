"""Context of a running application: its package, configuration, command line and output folder.

An error ends the application with a message of one sentence.
"""

import errno
import os
import re
import shutil
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig, OmegaConf

from .operations.signals import stop

PACKAGE = str(__package__)  # `pipelines` in a checkout, `lmd.pipelines` where lmd is installed
IN_CHECKOUT = PACKAGE == "pipelines"
LOCK = ".lock"  # file in a folder, locked by the process that works there
EXPERIMENT = "lmd"  # mlflow experiment of the commands in `SHARING`, which find or score a deployment or read such runs
SHARING = ("optimise", "evaluate", "report", "runs")
CONF = str(Path(__file__).resolve().parents[1] / "conf")  # beside this package, in a checkout and when installed
COUNT = "deployment.count="
SHOWN_AFTER = 2.0  # time after which a step's name is printed, seconds
# Keys that change no result of a run: its folder, speed, record and further outputs.
WITHOUT_EFFECT = (
    "tracking", "trust", "resume", "threads", "workers", "checkpoint_seconds", "picture", "pictures",
    "export", "paper_size", "kept",
)  # fmt: skip


def lmd_experiment(*, _root_: DictConfig) -> str:
    """Name of the mlflow experiment in which the composed command records its runs.

    This is `EXPERIMENT` for the commands in `SHARING`. Other commands have an experiment of their own, such as `lmd
    compare`.
    """
    studies = list(_root_.get("studies") or {})
    # The configuration of a job lacks Hydra's part, and a configuration composed from Python has no job.
    hydra = HydraConfig.get() if "hydra" not in _root_ and HydraConfig.initialized() else _root_.get("hydra")
    name = " ".join(studies) if studies and "score" not in studies else hydra.job.name if hydra else SHARING[0]
    return EXPERIMENT if name in SHARING else f"{EXPERIMENT} {name}"


OmegaConf.register_new_resolver("lmd.experiment", lmd_experiment, replace=True)
OmegaConf.register_new_resolver("lmd.env", lambda name, default: os.environ.get(name) or default, replace=True)
OmegaConf.register_new_resolver("lmd.package", lambda: PACKAGE, replace=True)
OmegaConf.register_new_resolver("lmd.conf", lambda name: str(Path(CONF, name)), replace=True)


def command_of(pipeline: str) -> str:
    """Text of the shell command that starts `pipeline`, for messages.

    This is `python -m pipelines.NAME` in a checkout, and `lmd-NAME` if the package is installed.
    """
    return f"python -m pipelines.{pipeline}" if IN_CHECKOUT else f"lmd-{pipeline.replace('_', '-')}"


def flat_settings(cfg: DictConfig, *keys: str) -> dict[str, Any]:
    """Resolved settings as a flat dictionary with dotted keys, such as `{"room.spacing": 0.5, ...}`.

    Args:
        cfg: configuration.
        keys: top-level keys whose settings are returned; all keys by default.
    """
    resolved: Any = OmegaConf.to_container(cfg, resolve=True)
    return _flat({key: resolved[key] for key in keys or resolved})


def _flat(node: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in node.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return flat


def run_directory() -> Path:
    """Hydra's output directory of this job."""
    return Path(HydraConfig.get().runtime.output_dir)


def choices(picked: Mapping[Any, Any] | None = None) -> dict[str, str]:
    """Option chosen in each config group, such as `{"room": "paper_simulation"}`, without Hydra's own groups.

    Hydra names a group that is placed at another key `GROUP@KEY`, such as `odometry@objective.odometry`. In the
    result, such a group has the name `KEY`, because mlflow allows no @ in names.

    Args:
        picked: Hydra's `choices`; by default the `choices` of this job.
    """
    picked = HydraConfig.get().runtime.choices if picked is None else picked
    return {k.rpartition("@")[2]: str(v) for k, v in picked.items() if v is not None and not k.startswith("hydra/")}


@contextmanager
def ends_reported() -> Iterator[None]:
    """Context in which an expected error ends the process with a message of one sentence and exit code 1.

    Expected errors are refused input (`InputError`), too little memory, a full disk, and a folder that has the name of
    a file to be written. After refused input or too little memory, the run's folder is removed if it has no results.
    """
    from lmd.core.checks import InputError

    try:
        with stop.raising():
            yield
    except (InputError, MemoryError) as error:
        discard_empty(run_directory())
        lack = "there is not enough memory for these settings: " if isinstance(error, MemoryError) else ""
        sys.exit(f"error: {lack}{error}")
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EISDIR):
            raise
        sys.exit(f"error: {error.filename or run_directory()}: {error.strerror}")


@contextmanager
def doing(step: str) -> Iterator[None]:
    """Context of one step of a command's work.

    The name `step` is printed if the step takes longer than `SHOWN_AFTER` seconds.
    """
    shown = threading.Timer(SHOWN_AFTER, print, [f"{step} ..."], {"file": sys.stderr, "flush": True})
    shown.daemon = True
    shown.start()
    try:
        yield
    finally:
        shown.cancel()


def say(text: str) -> None:
    """Print `text` unless it is empty.

    If stdout is a pipe to a program that has ended, such as `head`, the text is dropped.
    """
    try:
        print(text, end="\n" if text else "", flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def discard_empty(directory: Path) -> None:
    """Remove the directory of a run, unless it contains files of the run or is the working directory."""
    is_ours = directory.is_dir() and not directory.samefile(Path.cwd())
    if is_ours and {path.name for path in directory.iterdir()} <= {".hydra", LOCK}:
        shutil.rmtree(directory)


def spelled(override: str) -> str:
    """Return the override with its value in quotes if it sets `deployment.count` to a number with a plus sign.

    `deployment.count=+5` adds 5 landmarks to the fixed landmarks. Without quotes, Hydra would read +5 as the number 5,
    which is the total. Other overrides are returned unchanged.
    """
    return re.sub(r"(?<=[=,])\+(\d+)(?=,|$)", r"'+\1'", override) if override.startswith(COUNT) else override


def quoted(path: str | Path) -> str:
    """Path as text for the value of an override, in quotes if Hydra needs them."""
    escaped = str(path).replace("\\", "\\\\").replace("'", "\\'")
    return str(path) if re.fullmatch(r"[\w./-]*/[\w./-]*", str(path)) else f"'{escaped}'"


def key_and_value(override: str) -> tuple[str, str]:
    """Split an override, such as `+objective.n=2`, into its key and its value, here `objective.n` and `2`."""
    key, _, value = override.partition("=")
    return key.lstrip("+~"), value


def changes_results(key: str) -> bool:
    """True if a config key or group may affect the results of a run; the number of threads, for example, does not."""
    return re.split("[./@]", key)[0] not in WITHOUT_EFFECT


def search_path() -> list[str]:
    """Overrides of this process that add folders to Hydra's search path.

    A process that composes another configuration must pass these overrides first, because later overrides may choose
    options in the added folders.
    """
    own = HydraConfig.get().overrides.hydra if HydraConfig.initialized() else []
    return [override for override in own if override.startswith("hydra.searchpath=")]


def config_dir() -> list[str]:
    """Arguments `["--config-dir", FOLDER]` for another process; empty if this application was started without them."""
    sources = HydraConfig.get().runtime.config_sources
    return [word for source in sources if source.provider == "command-line" for word in ("--config-dir", source.path)]


def task_overrides() -> list[tuple[str, str]]:
    """Overrides of this job as pairs: the config key or group that is overridden, and the whole override."""
    return keyed_overrides(HydraConfig.get().overrides.task)


def keyed_overrides(overrides: Iterable[str]) -> list[tuple[str, str]]:
    """Split each override into a pair: the config key or group that is overridden, and the whole override."""
    parsed = OverridesParser.create().parse_overrides(list(overrides))
    return [(str(override.key_or_group), str(override.input_line)) for override in parsed]
