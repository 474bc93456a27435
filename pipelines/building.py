"""Building objects from a composed configuration, with messages that name its keys."""

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import hydra
from omegaconf import DictConfig, OmegaConf, open_dict

from .app import CONF
from .fixed import fixed_of, others_of, total_of
from .notes import note, note_edges, note_outside
from .spelling import meant
from .tag_sizes import divide_paper, spell_counts, take_sizes

if TYPE_CHECKING:
    from lmd.geometry.camera import Camera
    from lmd.objectives.base import Objective
    from lmd.optimisers.base import Optimiser
    from lmd.optimisers.ledger import Budget
    from lmd.problem import Problem
    from lmd.scene.deployment import Deployment
    from lmd.scene.deployment_sources import DeploymentSource
    from lmd.scene.pdf import OrientationPdf
    from lmd.scene.recorded_poses import RecordedPoses
    from lmd.scene.rig import Rig
    from lmd.scene.scene import Scene
    from lmd.space.space import Space

# What every problem has settings of.
GROUPS = ("room", "camera", "visibility", "objective", "encoding", "deployment")
RUN_BYTES = 1000  # at the least, of each of several runs
# Settings that are true or false.
SWITCHES = ("validate", "picture", "page", "localisation", "losses", "sensitivity", "all_visible")


@contextmanager
def keyed(group: str = "", **keys: str) -> Iterator[None]:
    """Where an `InputError` begins with an argument, let it begin with the config key that the argument came from.

    Args:
        group: has the arguments as its keys; none for keys at the top.
        keys: of arguments that come from elsewhere, by the names of the arguments.
    """
    from lmd.core.checks import InputError

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

    from lmd.core.checks import InputError
    from lmd.core.optional import missing_of

    try:
        return hydra.utils.instantiate(node, **extra, _convert_="all")
    except InstantiationException as error:
        cause: BaseException | None = error.__cause__
        while cause is not None and not isinstance(cause, InputError):
            cause = cause.__cause__
        lacks = missing_of(error)
        if lacks is not None:
            raise lacks from None
        if cause is not None:
            with keyed(str(error).partition("full_key: ")[2].strip(), **{name: name for name in extra}):
                raise cause from None
        text = " ".join(str(error).split())
        if unknown := re.search(r"unexpected keyword argument '(\w+)'.* full_key: ([\w.]+)", text):
            key = f"{unknown[2]}.{unknown[1]}"
            hint = _set_by_experiment(key) or meant(key, CONF)
            raise InputError(f"{key} is no setting that is known; {hint}".rstrip("; ")) from error
        raise InputError(text) from error


def _set_by_experiment(key: str) -> str:
    """How to leave out a key that an experiment sets for another choice of its group; empty if it sets none."""
    from hydra.core.hydra_config import HydraConfig

    if not HydraConfig.initialized():
        return ""
    asked, name = HydraConfig.get().overrides.task, HydraConfig.get().runtime.choices.get("experiment")
    own = name is None or any(each.lstrip("+").partition("=")[0] == key for each in asked)
    return "" if own else f"experiment={name} sets it for another {key.partition('.')[0]}: leave it out by ~{key}"


def settings_of(cfg: DictConfig, key: str) -> DictConfig:
    """The settings below a key.

    Raises:
        InputError: there are none.
    """
    from lmd.core.checks import InputError

    found = OmegaConf.select(cfg, key)
    if not isinstance(found, DictConfig):
        raise InputError(f"{key} must be settings or the name of some, got {found!r}.")
    return found


def budget_of(cfg: DictConfig) -> "Budget":
    """The budget of a configuration.

    Raises:
        InputError: it is none.
    """
    from lmd.optimisers.ledger import Budget

    budget = settings_of(cfg, "budget")
    with keyed("budget"):
        return Budget(budget.evaluations, budget.seconds)


def seeds_of(cfg: DictConfig) -> range:
    """The seeds of several runs: `seed`, `seed + 1` and so on, as many as `seeds` says.

    Raises:
        InputError: one of the two is refused, or they are more than there is memory for.
    """
    from lmd.core.checks import integer, seed_number
    from lmd.core.memory import check_memory

    seed, count = seed_number(cfg.seed), integer("seeds", cfg.seeds, low=1)
    check_memory(RUN_BYTES * count, f"seeds = {count} runs", "seeds")
    return range(seed, seed + count)


def camera_of(node: DictConfig) -> "Camera | Rig":
    """The camera of a configuration, or those of its rig.

    Raises:
        InputError: the rig is none, or a camera is refused; that of the group is made only where a mount has none.
    """
    from lmd.formats.rigs import brings_cameras, rig_of
    from lmd.scene.rig import cameras_of

    alone = deepcopy(node)
    with open_dict(alone):
        alone.pop("rig", None)
    mounts = mounts_of(node)
    if mounts is None:
        made = instantiate(alone)
    else:
        with keyed("camera"):
            made = rig_of(mounts, None if brings_cameras(mounts) else instantiate(alone))
    for camera in cameras_of(made):
        note(camera.note)
    return made  # type: ignore[no-any-return]


def mounts_of(node: DictConfig) -> Any:
    """The cameras of a rig as `lmd.formats.rigs.rig_of` takes them; None for none.

    Raises:
        InputError: their file cannot be read.
    """
    from lmd.formats.rigs import read_mounts

    mounts = node.get("rig")  # runs of old have none
    plain = OmegaConf.to_container(mounts, resolve=True) if OmegaConf.is_config(mounts) else mounts
    with keyed("camera"):
        return read_mounts(plain) if isinstance(plain, str) else plain


class Parts(NamedTuple):
    """The parts of a problem that a configuration describes, see `lmd.problem.Problem`."""

    scene: "Scene"
    objective: "Objective"
    start: "DeploymentSource"
    threads: int | None
    fixed: "Deployment | None"

    def draw(self, seed: int) -> "Deployment":
        """A deployment of the problem."""
        import numpy as np

        return self.scene.plates.draw(self.start, np.random.default_rng(seed), self.fixed)


def build_problem(cfg: DictConfig, count: str = "deployment.count") -> "Problem":
    """The problem a composed configuration describes.

    Args:
        count: the key by which the user says how many landmarks there are.

    Raises:
        InputError: its parts do not fit together.
    """
    from lmd.problem import Problem

    parts = build_parts(cfg, count)
    with keyed("objective", rig="camera.rig"):
        return Problem(*parts)


def build_parts(cfg: DictConfig, count: str = "deployment.count") -> Parts:
    """The parts of a problem, of which the objective need not fit the landmarks; see `build_problem`."""
    import numpy as np

    from lmd.core.checks import InputError, boolean, check_members, choice, integer, seed_number
    from lmd.core.optional import optional
    from lmd.core.threads import MOST_THREADS
    from lmd.objectives.base import Objective
    from lmd.optimisers.encoding import KINDS
    from lmd.scene.criteria import Criteria
    from lmd.scene.scene import Scene
    from lmd.scene.tag import Tag
    from lmd.space.space import Space

    for group in GROUPS:
        settings_of(cfg, group)
    if "relevance" in cfg.room:
        settings_of(cfg, "room.relevance")
    cfg.seed = seed_number(cfg.seed)
    if cfg.get("workers") is not None:
        integer("workers", cfg.workers, low=1)
    for switch in SWITCHES:
        if switch in cfg:
            boolean(switch, cfg[switch])
    if cfg.get("page"):
        optional("plotly", "page")
    spell_counts(cfg)
    if "tag" in cfg.visibility:  # it is of tags, not of points
        with keyed("deployment"):
            take_sizes(cfg)
    tag = instantiate(cfg.tag) if cfg.get("tag") else Tag()  # runs of old have none
    camera, visibility = camera_of(cfg.camera), instantiate(cfg.visibility)
    room, pdf, recorded = _poses(cfg)
    check_members("room", room, Space, "docs/api/space.md")
    check_members("visibility", visibility, Criteria, "docs/api/scene.md")
    scene = Scene(room, camera, pdf, visibility, tag, recorded)
    threads = None if cfg.threads is None else integer("threads", cfg.threads, low=1, high=MOST_THREADS)
    choice("encoding.kind", cfg.encoding.kind, KINDS)
    boolean("encoding.flush", cfg.encoding.flush)
    objective = instantiate(cfg.objective)
    check_members("objective", objective, Objective, "docs/api/objectives.md")
    with keyed("deployment", count=count, family="tag.family"):
        fixed = fixed_of(cfg.deployment, tag.own_family)
    with keyed("tag"):
        scene, found = divide_paper(cfg, scene, objective, threads, fixed)
        tag = scene.tag
    note(found)
    with keyed("deployment", count=count, counts="tag.counts"):
        total = total_of(cfg.deployment, fixed)
    start = instantiate(others_of(cfg.deployment, fixed, total))
    with keyed("tag"):
        scene.plates.hanging.surfaces()
    # What only shows when the parts meet; the problem would refuse it too, but could not tell whose argument it is.
    with keyed("room.relevance"):
        scene.room.relevance.weights(scene.room.grid())
    with keyed("deployment", count=count, counts="tag.counts", family="tag.family"):
        hung = {} if fixed is None else {"fixed": scene.plates.hung(fixed, start)}
        if isinstance(start, partial):  # a source that depends on what the landmarks are for
            start = start(scene=scene, objective=objective, threads=threads, **hung)
        drawn = scene.plates.draw(start, np.random.default_rng(0), **hung)
        note(drawn.note)
        ids = drawn.ids
        if total not in (None, len(ids)):
            raise InputError(f"count = {total}, but with the fixed ones there are {len(ids)} landmarks.", "count")
    if not tag.is_point:
        with keyed("tag"):
            tag.check_ids(ids)
        note_edges(tag, drawn)
    if cfg.deployment.get("free"):
        note_outside(scene.room, tag, drawn)
    return Parts(scene, objective, start, threads, hung.get("fixed"))


def _poses(cfg: DictConfig) -> "tuple[Space, OrientationPdf, RecordedPoses | None]":
    """Where the camera is, how it looks there, and the recording that says so, if one does."""
    from lmd.core.checks import InputError

    room, recorded = instantiate(cfg.room), bool(cfg.get("poses"))  # runs of old have none
    if scan := getattr(room, "scan", None):  # of a mesh
        if doubt := scan.doubt:
            print(
                f"warning: room.up: is it right for {scan.mesh.path!r}? {doubt[0].upper()}{doubt[1:]}", file=sys.stderr
            )
        note(scan.mesh.note)
    if recorded == bool(cfg.pdf):
        needed = "poses=recorded, which says how the camera looks, needs pdf=recorded"
        cure = "add it to the command line where an experiment has chosen another one"
        raise InputError(f"{needed}; {cure}." if recorded else "pdf=recorded needs poses=recorded.")
    if not recorded:
        return room, instantiate(cfg.pdf), None
    poses = instantiate(cfg.poses, group="poses.")
    with keyed("poses"):
        visited = poses.visited(room)
    note(poses.note)
    return visited, poses.pdf, poses


def build_optimiser(cfg: DictConfig, seed: int) -> "Optimiser":
    """The optimiser a composed configuration describes.

    Raises:
        InputError: it cannot be built, or is none.
    """
    from lmd.core.checks import InputError
    from lmd.optimisers.base import AskTell, Optimiser

    optimiser = instantiate(settings_of(cfg, "optimiser"), seed=seed)
    if not isinstance(optimiser, Optimiser):
        raise InputError(
            f"optimiser._target_ = {cfg.optimiser.get('_target_')!r} makes a {type(optimiser).__name__}, which is not "
            "derived from lmd.optimisers.base.Optimiser."
        )
    if isinstance(optimiser, AskTell):
        cfg.encoding.kind = optimiser.encoding = optimiser.encoding or cfg.encoding.kind  # what is used is recorded
        optimiser.flush = cfg.encoding.flush
    return optimiser
