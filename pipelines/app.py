"""Context of a running application: package, configuration, command line and folder; and errors in one sentence."""

import errno
import os
import re
import shutil
import sys
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
# Keys that change no result of a run: its folder, speed, record and further outputs.
WITHOUT_EFFECT = (
    "tracking", "trust", "resume", "threads", "workers", "checkpoint_seconds", "picture", "pictures",
    "export", "paper_size", "kept",
)  # fmt: skip


def lmd_experiment(*, _root_: DictConfig) -> str:
    """mlflow experiment of the composed command: `EXPERIMENT`, or the command's own, such as `lmd compare`."""
    studies = list(_root_.get("studies") or {})
    if studies and "score" not in studies:
        name = " ".join(studies)
    elif "hydra" in _root_:
        name = _root_.hydra.job.name
    else:  # the configuration of a job lacks Hydra's part; a configuration composed from Python has no job
        name = HydraConfig.get().job.name if HydraConfig.initialized() else SHARING[0]
    return EXPERIMENT if name in SHARING else f"{EXPERIMENT} {name}"


OmegaConf.register_new_resolver("lmd.experiment", lmd_experiment, replace=True)
OmegaConf.register_new_resolver("lmd.env", lambda name, default: os.environ.get(name) or default, replace=True)
OmegaConf.register_new_resolver("lmd.package", lambda: PACKAGE, replace=True)
OmegaConf.register_new_resolver("lmd.conf", lambda name: str(Path(CONF, name)), replace=True)


def command_of(pipeline: str) -> str:
    """Command of a pipeline for messages, in the form in which the user called this process."""
    return f"python -m pipelines.{pipeline}" if IN_CHECKOUT else f"lmd-{pipeline.replace('_', '-')}"


def flat_settings(cfg: DictConfig, *keys: str) -> dict[str, Any]:
    """Resolved settings below `keys` (by default all), such as `{"room.spacing": 0.5, ...}`."""
    resolved: Any = OmegaConf.to_container(cfg, resolve=True)
    return {name: value for key in keys or resolved for name, value in _leaves(key, resolved[key])}


def _leaves(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _leaves(f"{key}.{name}", inner)
    else:
        yield key, value


def run_directory() -> Path:
    """Hydra's output directory of this job."""
    return Path(HydraConfig.get().runtime.output_dir)


def choices() -> dict[str, str]:
    """Option picked in each config group, such as `{"room": "paper_simulation"}`."""
    return chosen(HydraConfig.get().runtime.choices)


def chosen(picked: Mapping[Any, Any]) -> dict[str, str]:
    """Hydra's `choices` without Hydra's own groups. A group in another place, such as `odometry@objective.odometry`,
    gets the name of this place, as mlflow allows no @ in names.
    """
    return {k.rpartition("@")[2]: str(v) for k, v in picked.items() if v is not None and not k.startswith("hydra/")}


@contextmanager
def ends_reported() -> Iterator[None]:
    """Context that ends with one sentence and exit code 1 on bad input, a full disk, or a folder in a file's place.

    Bad input leaves no folder. A failed allocation of memory counts as bad input, as only the largest arrays are
    checked beforehand (`lmd.core.memory`).
    """
    from lmd.core.checks import InputError

    try:
        with stop.raising():
            yield
    except (InputError, MemoryError) as error:
        discard_empty(run_directory())
        lack = "there is not enough memory for these settings: " if isinstance(error, MemoryError) else ""
        print(f"error: {lack}{error}", file=sys.stderr)
        sys.exit(1)
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EISDIR):
            raise
        print(f"error: {error.filename or run_directory()}: {error.strerror}", file=sys.stderr)
        sys.exit(1)


def say(text: str) -> None:
    """Print text; if the reader of stdout, such as `head`, has ended, the text is dropped silently."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def discard_empty(directory: Path) -> None:
    """Remove the directory of a run, unless it holds files of the run or is the working directory."""
    if not directory.is_dir() or directory.samefile(Path.cwd()):
        return
    if {path.name for path in directory.iterdir()} <= {".hydra", LOCK}:
        shutil.rmtree(directory)


def spelled(override: str) -> str:
    """Quote the value of an override such as `deployment.count=+5`, as Hydra would read `+5` as the number 5."""
    return re.sub(r"(?<=[=,])\+(\d+)(?=,|$)", r"'+\1'", override) if override.startswith(COUNT) else override


def at(key: str, path: Path) -> str:
    """Override of a key with a path, in quotes if Hydra needs them."""
    return f"{key}={path}" if re.fullmatch(r"[\w./-]+", str(path)) else f"{key}={quoted(path)}"


def quoted(path: str | Path) -> str:
    """Path as the value of an override, in quotes."""
    escaped = str(path).replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"


def key_and_value(override: str) -> tuple[str, str]:
    """Split an override, such as `+objective.n=2`, into key and value (`objective.n`, `2`)."""
    key, _, value = override.partition("=")
    return key.lstrip("+~"), value


def changes_results(key: str) -> bool:
    """False for a key, or a group, that changes no result of a run."""
    return re.split("[./@]", key)[0] not in WITHOUT_EFFECT


def search_path() -> list[str]:
    """Overrides that add folders of configuration; other overrides depend on these."""
    own = HydraConfig.get().overrides.hydra if HydraConfig.initialized() else []
    return [override for override in own if override.startswith("hydra.searchpath=")]


def config_dir() -> list[str]:
    """Option `--config-dir` of this application, to be passed to another process; empty without such an option."""
    sources = HydraConfig.get().runtime.config_sources
    return [word for source in sources if source.provider == "command-line" for word in ("--config-dir", source.path)]


def task_overrides() -> list[tuple[str, str]]:
    """Overrides of this job: pairs of a key (or group) and the override."""
    return keyed_overrides(HydraConfig.get().overrides.task)


def keyed_overrides(overrides: Iterable[str]) -> list[tuple[str, str]]:
    """Pairs of a key (or group) and the override."""
    parsed = OverridesParser.create().parse_overrides(list(overrides))
    return [(str(override.key_or_group), str(override.input_line)) for override in parsed]
