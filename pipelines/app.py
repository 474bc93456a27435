"""What the pipelines share: where the configuration is, building objects from it, and reporting bad input."""

import atexit
import errno
import gc
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf, open_dict

from .fixed import fixed_of, others_of, quoted, total_of
from .signals import Stopped, stop

if TYPE_CHECKING:
    from lmd.camera import Camera
    from lmd.optimisers.base import Optimiser
    from lmd.pdf import OrientationPdf
    from lmd.problem import Problem
    from lmd.recorded_poses import RecordedPoses
    from lmd.rig import Rig
    from lmd.space.space import Space

PACKAGE = str(__package__)  # `pipelines` in a checkout, `lmd.pipelines` where lmd is installed
IN_CHECKOUT = PACKAGE == "pipelines"
# Settings that are true or false.
SWITCHES = ("validate", "page", "localisation", "losses", "sensitivity", "all_visible")
GARBAGE = 100_000  # objects before Python looks for garbage: at its 700, that takes a quarter of all imports
CONF = str(Path(__file__).resolve().parents[1] / "conf")  # beside this package in both


def lmd_package() -> str:
    """The name of this package, for the configuration."""
    return PACKAGE


OmegaConf.register_new_resolver("lmd.package", lmd_package, replace=True)


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
            atexit.register(gc.freeze)  # Python looks for garbage once more when it ends: with mlflow, for a second
            try:
                with stop.raising():
                    composed()
            except Stopped as told:
                sys.exit(told.code)

        return main

    return decorate


def command_of(pipeline: str) -> str:
    """What starts a pipeline from where this one was started, for messages."""
    return f"python -m pipelines.{pipeline}" if IN_CHECKOUT else f"lmd-{pipeline.replace('_', '-')}"


@contextmanager
def keyed(group: str = "", **keys: str) -> Iterator[None]:
    """Where an `InputError` begins with an argument, let it begin with the config key that the argument came from.

    Args:
        group: has the arguments as its keys; none for keys at the top.
        keys: of arguments that come from elsewhere, by the names of the arguments.
    """
    from lmd.checks import InputError

    try:
        yield
    except InputError as error:
        if error.argument is None:
            raise
        argument = re.split(r"[^\w]", error.argument)[0]
        named = argument == group.split(".")[0]  # by what was written to name its keys itself
        key = keys.get(argument, argument if named or not group else f"{group}.{argument}")
        raise InputError(key + str(error).removeprefix(argument)) from None


def instantiate(node: Any, **extra: Any) -> Any:
    """Build the object a config node describes; the only place that calls Hydra's instantiate.

    Raises:
        InputError: the object refuses its arguments.
    """
    from hydra.errors import InstantiationException

    from lmd.checks import InputError

    try:
        return hydra.utils.instantiate(node, **extra, _convert_="all")
    except InstantiationException as error:
        cause: BaseException | None = error.__cause__
        while cause is not None and not isinstance(cause, InputError):
            cause = cause.__cause__
        if cause is not None:
            with keyed(str(error).partition("full_key: ")[2].strip(), **{name: name for name in extra}):
                raise cause from None
        raise InputError(" ".join(str(error).split())) from error


def camera_of(node: DictConfig) -> "Camera | Rig":
    """The camera of a configuration, or those of its rig.

    Raises:
        InputError: the rig is none, or a camera is refused; that of the group is made only where a mount has none.
    """
    from lmd.rig import has_own_camera, rig_of

    mounts = node.get("rig")  # runs of old have none
    alone = OmegaConf.masked_copy(node, [str(key) for key in node if key != "rig"])
    if mounts is None:
        return instantiate(alone)  # type: ignore[no-any-return]
    plain = OmegaConf.to_container(mounts, resolve=True) if OmegaConf.is_config(mounts) else mounts
    own = isinstance(plain, list) and bool(plain) and all(map(has_own_camera, plain))
    with keyed("camera"):
        return rig_of(plain, None if own else instantiate(alone))


def build_problem(cfg: DictConfig) -> "Problem":
    """The problem a composed configuration describes.

    Raises:
        InputError: its parts do not fit together.
    """
    import numpy as np

    from lmd.checks import InputError, boolean, choice, integer
    from lmd.optimisers.encoding import KINDS
    from lmd.problem import Problem
    from lmd.scene import Scene
    from lmd.sight.evaluator import MOST_THREADS
    from lmd.tag import Tag

    cfg.seed = integer("seed", cfg.seed, low=0)
    if cfg.get("workers") is not None:
        integer("workers", cfg.workers, low=1)
    for switch in SWITCHES:
        if switch in cfg:
            boolean(switch, cfg[switch])
    tag = instantiate(cfg.tag) if cfg.get("tag") else Tag()  # runs of old have none
    camera, visibility = camera_of(cfg.camera), instantiate(cfg.visibility)
    room, pdf, recorded = _poses(cfg)
    scene = Scene(room, camera, pdf, visibility, tag, recorded)
    threads = None if cfg.threads is None else integer("threads", cfg.threads, low=1, high=MOST_THREADS)
    choice("encoding.kind", cfg.encoding.kind, KINDS)
    boolean("encoding.flush", cfg.encoding.flush)
    objective = instantiate(cfg.objective)
    with keyed("deployment"):
        fixed = fixed_of(cfg.deployment)
        total = total_of(cfg.deployment, fixed)
    start = instantiate(others_of(cfg.deployment, fixed, total))
    with keyed("tag"):
        scene.plates.hanging.surfaces()
    # What only shows when the parts meet; the problem would refuse it too, but could not tell whose argument it is.
    with keyed("room.relevance"):
        scene.room.relevance.weights(scene.room.grid())
    with keyed("deployment"):
        hung = {} if fixed is None else {"fixed": scene.plates.hung(fixed)}
        if isinstance(start, partial):  # a source that depends on what the landmarks are for
            start = start(scene=scene, objective=objective, threads=threads, **hung)
        ids = scene.plates.draw(start, np.random.default_rng(0), **hung).ids
        if total not in (None, len(ids)):
            raise InputError(f"count = {total}, but with the fixed ones there are {len(ids)} landmarks.", "count")
    if not tag.is_point:
        with keyed("tag"):
            tag.check_ids(ids)
    with keyed("objective", rig="camera.rig"):
        return Problem(scene, objective, start, threads, **hung)


def _poses(cfg: DictConfig) -> "tuple[Space, OrientationPdf, RecordedPoses | None]":
    """Where the camera is, how it looks there, and the recording that says so, if one does."""
    from lmd.checks import InputError

    room, recorded = instantiate(cfg.room), bool(cfg.get("poses"))  # runs of old have none
    if recorded == bool(cfg.pdf):
        needed = "poses=recorded, which says how the camera looks, needs pdf=recorded, which follows by itself"
        raise InputError(f"{needed}." if recorded else "pdf=recorded needs poses=recorded.")
    if not recorded:
        return room, instantiate(cfg.pdf), None
    poses = instantiate(cfg.poses)
    with keyed("poses"):
        return poses.visited(room), poses.pdf, poses


def build_optimiser(cfg: DictConfig, seed: int) -> "Optimiser":
    """The optimiser a composed configuration describes.

    Raises:
        InputError: it cannot be built, or is none.
    """
    from lmd.checks import InputError
    from lmd.optimisers.base import AskTell, Optimiser

    optimiser = instantiate(cfg.optimiser, seed=seed)
    if not isinstance(optimiser, Optimiser):
        raise InputError(
            f"optimiser._target_ = {cfg.optimiser.get('_target_')!r} makes a {type(optimiser).__name__}, which is not "
            "derived from lmd.optimisers.base.Optimiser."
        )
    if isinstance(optimiser, AskTell):
        optimiser.encoding, optimiser.flush = optimiser.encoding or cfg.encoding.kind, cfg.encoding.flush
    return optimiser


def save_path(save_as: Any) -> Path | None:
    """`save_as`, whose folder is made and tried before anything has run; None for null.

    Raises:
        InputError: it is no text, or its folder cannot be written to.
    """
    from lmd.checks import InputError, file_path

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

    from lmd.checks import InputError

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

    Memory that is refused counts as bad input: what takes most is estimated (`lmd.memory`), the rest is not.
    """
    from lmd.checks import InputError

    try:
        yield
    except (InputError, MemoryError) as error:
        discard_empty(run_directory())
        lack = "there is not enough memory for these settings: " if isinstance(error, MemoryError) else ""
        print(f"error: {lack}{error}", file=sys.stderr)
        sys.exit(1)
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        print(f"error: {error.filename or run_directory()}: {error.strerror}", file=sys.stderr)
        sys.exit(1)


def discard_empty(directory: Path) -> None:
    """Remove the directory of a run if nothing came of it."""
    if directory.is_dir() and {path.name for path in directory.iterdir()} <= {".hydra"}:
        shutil.rmtree(directory)
