"""What the pipelines share: where the configuration is, what was asked for, and reporting bad input."""

import errno
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf, open_dict

from .fixed import quoted
from .hyperparameters import over_defaults
from .operations.signals import stop

PACKAGE = str(__package__)  # `pipelines` in a checkout, `lmd.pipelines` where lmd is installed
IN_CHECKOUT = PACKAGE == "pipelines"
GARBAGE = 100_000  # objects before Python looks for garbage: at its 700, that takes a quarter of all imports
CONF = str(Path(__file__).resolve().parents[1] / "conf")  # beside this package in both


def lmd_package() -> str:
    """The name of this package, for the configuration."""
    return PACKAGE


def lmd_conf(name: str) -> str:
    """A file beside the configuration that comes with it."""
    return str(Path(CONF, name))


def lmd_help(*, _root_: DictConfig) -> str:
    """What `--help` shows: the groups that this command composes, a line for each with its options."""
    from hydra.core.global_hydra import GlobalHydra

    loader, hydra = GlobalHydra.instance().config_loader(), _root_.hydra
    picked = {str(group).partition("@")[0] for group in hydra.runtime.choices}
    # Of a group of which several options are picked, only the key is there.
    groups = [group for group in sorted(loader.list_groups("")) if group in picked or group in _root_]
    groups.remove("hydra")
    lines = [f"{group}: {', '.join(loader.get_group_options(group))}" for group in groups]
    told = f"{command_of(hydra.job.name)} [group=option] [key=value]"
    return "\n".join([told, "", *lines, "", "--cfg job shows every key with its value, -m makes a sweep."])


OmegaConf.register_new_resolver("lmd.help", lmd_help, replace=True)
OmegaConf.register_new_resolver("lmd.package", lmd_package, replace=True)
OmegaConf.register_new_resolver("lmd.conf", lmd_conf, replace=True)


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
            config_name,
            [over_defaults(quoted(override)) for override in overrides],
            RunMode.RUN,
            validate_sweep_overrides=False,
        )
    except (HydraException, ValueError) as error:  # of an option that is a number, Hydra raises the latter
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
    return chosen(HydraConfig.get().runtime.choices)


def chosen(picked: Mapping[Any, Any]) -> dict[str, str]:
    """The options among Hydra's `choices` that are not its own."""
    return {str(k): str(v) for k, v in picked.items() if not str(k).startswith("hydra/") and v is not None}


@contextmanager
def ends_reported() -> Iterator[None]:
    """Turn bad input, a full disk or a folder in a file's place into one sentence on stderr and exit code 1.

    Bad input leaves no trace.
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
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EISDIR):
            raise
        print(f"error: {error.filename or run_directory()}: {error.strerror}", file=sys.stderr)
        sys.exit(1)


def discard_empty(directory: Path) -> None:
    """Remove the directory of a run if nothing came of it, but not where the user is, as with commands that talk."""
    if not directory.is_dir() or directory.samefile(Path.cwd()):
        return
    if {path.name for path in directory.iterdir()} <= {".hydra"}:
        shutil.rmtree(directory)
