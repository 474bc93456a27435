"""Construction of problem, optimiser and budget from a composed configuration."""

import sys
from collections import Counter
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from omegaconf import DictConfig, OmegaConf

from .app import doing
from .composing import editable
from .landmarks import divide_paper, fixed_of, others_of, spell_counts, take_sizes
from .nodes import instantiate, keyed, note, plain, settings_of

if TYPE_CHECKING:
    from lmd.geometry.camera import Camera
    from lmd.objectives.base import Objective
    from lmd.optimisers.base import Optimiser
    from lmd.optimisers.ledger import Budget
    from lmd.problem import Problem
    from lmd.scene.criteria import Criteria
    from lmd.scene.deployment import Deployment
    from lmd.scene.deployment_sources import DeploymentSource
    from lmd.scene.rig import Rig
    from lmd.scene.scene import Scene
    from lmd.scene.tag import Tag
    from lmd.space.crowd import Crowd
    from lmd.space.space import Space

GROUPS = ("room", "camera", "tag", "visibility", "objective", "encoding", "deployment")  # groups of every problem
SWITCHES = ("encoding.flush", "validate", "picture", "localisation", "losses", "sensitivity", "all_visible")
RUN_BYTES = 1000  # minimum memory of one of several runs, bytes
SAME_EDGE = 1e-6  # maximum difference between edges that count as equal, metres


class Parts(NamedTuple):
    """Arguments of `lmd.problem.Problem`, which are not yet checked against each other.

    For example, the objective may not support the landmarks.
    """

    scene: "Scene"
    objective: "Objective"
    start: "DeploymentSource"
    threads: int | None
    fixed: "Deployment | None"

    def draw(self, seed: int) -> "Deployment":
        """Draw a deployment of the problem with random numbers from `seed`."""
        import numpy as np

        return self.scene.footprints.draw(self.start, np.random.default_rng(seed), self.fixed)


def build_problem(cfg: DictConfig, count: str = "deployment.count") -> "Problem":
    """Build the problem of a configuration.

    Args:
        cfg: the configuration.
        count: config key that gives the number of landmarks, for error messages.

    Raises:
        InputError: the parts of the problem do not fit together.
    """
    from lmd.problem import Problem

    with doing("building the problem"):
        parts = build_parts(cfg, count)
        with keyed("objective", rig="camera.rig"):
            return Problem(*parts)


def build_parts(cfg: DictConfig, count: str = "deployment.count") -> Parts:
    """Build the parts of a problem without checking that the parts fit together.

    Args:
        cfg: the configuration.
        count: config key that gives the number of landmarks, for error messages.

    Raises:
        InputError: a part refuses its arguments, or the landmarks cannot be drawn.
    """
    from lmd.core.checks import InputError, check_members, integer
    from lmd.core.threads import MOST_THREADS
    from lmd.objectives.base import Objective

    _check_settings(cfg)
    cfg = editable(cfg)  # sizes and counts that follow from files, lists or limits are written into it
    spell_counts(cfg.deployment, cfg.tag)
    if "tag" in cfg.visibility:  # the model is for tags, not for points
        with keyed("deployment"):
            take_sizes(cfg.deployment, cfg.tag)
    scene = _scene(cfg)
    threads = None if cfg.threads is None else integer("threads", cfg.threads, low=1, high=MOST_THREADS)
    objective = instantiate(cfg.objective)
    with keyed("objective"):
        if not hasattr(objective, "n") and callable(objective):  # an objective along drives is built for the scene
            objective, scene = objective(scene)
    check_members("objective", objective, Objective, "docs/extend.md")
    names = partial(keyed, "deployment", count=count, counts="tag.counts", family="tag.family")
    with names():
        fixed = fixed_of(cfg.deployment, scene.tag.own_family)
    with keyed("tag"):
        scene = divide_paper(cfg, scene, objective, threads, fixed)
    with names():
        total, source = others_of(cfg.deployment, fixed)
    start = instantiate(source)
    # The problem repeats these checks, but its messages cannot name the key.
    with keyed("tag"):
        scene.footprints.hanging.surfaces()
    with keyed("room.relevance"):
        scene.room.relevance.weights(scene.room.grid())
    with names():
        if fixed is not None:
            fixed = scene.footprints.checked_fixed(fixed, start)
        if isinstance(start, partial):  # the source depends on the objective
            start = start(scene=scene, objective=objective, threads=threads, fixed=fixed)
        parts = Parts(scene, objective, start, threads, fixed)
        drawn = parts.draw(0)
        note(drawn.note)
        if total not in (None, len(drawn)):
            raise InputError(f"count = {total}, but there are {len(drawn)} landmarks, fixed ones included.", "count")
    if not scene.tag.is_point:
        with keyed("tag"):
            scene.tag.check_ids(drawn.ids)
        _note_unusual(scene.room, scene.tag, drawn)
    return parts


def _check_settings(cfg: DictConfig) -> None:
    """Check the settings that are not passed to an object of the problem, as each object checks its own settings.

    Raises:
        InputError: a setting has a value that is not allowed.
    """
    from lmd.core.checks import boolean, choice, integer, seed_number
    from lmd.optimisers.encoding import KINDS

    for group in (*GROUPS, *(("room.relevance",) if "relevance" in (cfg.room or ()) else ())):
        settings_of(cfg, group)
    choice("encoding.kind", cfg.encoding.kind, KINDS)
    seed_number(cfg.seed)
    if cfg.get("workers") is not None:
        integer("workers", cfg.workers, low=1)
    for switch in SWITCHES:
        if (value := OmegaConf.select(cfg, switch, default=False)) is not False:
            boolean(switch, value)


def _scene(cfg: DictConfig) -> "Scene":
    """Build the scene of a configuration.

    Raises:
        InputError: a part of the scene refuses its arguments.
    """
    from lmd.core.checks import InputError, check_members
    from lmd.scene.scene import Scene
    from lmd.space.space import Space

    tag, camera = instantiate(cfg.tag), camera_of(cfg.camera)
    visibility, crowd = visibility_of(cfg.visibility)
    room, is_recorded = instantiate(cfg.room), bool(cfg.get("poses"))
    if (scan := getattr(room, "scan", None)) and (doubt := scan.doubt):  # the room is a mesh
        print(f"warning: room.up: check it for {scan.mesh.path!r}: {doubt}", file=sys.stderr)
    if plan := getattr(room, "plan", None):
        note(plan.note)
    if is_recorded == bool(cfg.pdf):
        needed = "poses=recorded needs pdf=recorded, the recorded directions"
        cure = "add it to the command line if an experiment sets another pdf"
        raise InputError(f"{needed}; {cure}." if is_recorded else "pdf=recorded needs poses=recorded.")
    recorded = instantiate(cfg.poses, group="poses.") if is_recorded else None
    pdf = instantiate(cfg.pdf) if recorded is None else recorded.pdf
    with keyed("poses"):
        if recorded is not None:
            room = recorded.visited(room)
            note(recorded.note)
    check_members("room", room, Space, "docs/extend.md")
    with keyed("visibility.crowd", crowd="visibility.crowd"):
        states = None if crowd is None else crowd.drawn(room)
    with keyed(crowd="visibility.crowd"):
        return Scene(room, camera, pdf, visibility, tag, recorded, crowd=states)


def camera_of(node: DictConfig) -> "Camera | Rig":
    """Build the camera or the rig of the config group `camera`.

    For a rig, the group's camera is built only if a mount has no camera of its own.

    Args:
        node: the group.

    Raises:
        InputError: a camera or the rig refuses its arguments.
    """
    alone = editable(node)
    if (mounts := plain(alone.pop("rig", None))) is None:
        made = instantiate(alone)
    else:
        from lmd.formats.rigs import brings_cameras, read_mounts, rig_of

        with keyed("camera"):
            mounts = read_mounts(mounts) if isinstance(mounts, str) else mounts
            made = rig_of(mounts, None if brings_cameras(mounts) else instantiate(alone))
    for camera in made.cameras:
        note(camera.note)
    return made  # type: ignore[no-any-return]


def visibility_of(node: DictConfig) -> "tuple[Criteria, Crowd | None]":
    """Build the visibility model and the crowd of the config group `visibility`; the crowd is None if none is set.

    Raises:
        InputError: the visibility model or the crowd refuses its arguments.
    """
    from lmd.core.checks import check_members
    from lmd.scene.criteria import Criteria
    from lmd.space.crowd import Crowd
    from lmd.space.parts import made

    alone = editable(node)
    given = plain(alone.pop("crowd", None)) or None
    criteria = instantiate(alone)
    check_members("visibility", criteria, Criteria, "docs/extend.md")
    settings = given if isinstance(given, dict) else {"number": given}
    return criteria, given and made("visibility.crowd", {"number": None, **settings}, Crowd)


def refuse_crowd(problem: "Problem", command: str) -> None:
    """Raise `InputError` if the problem has a crowd, which `command` does not support."""
    from lmd.core.checks import InputError

    if problem.scene.crowd is not None:
        raise InputError(f"{command} does not work with visibility.crowd: leave it out.")


def _note_unusual(room: "Space", tag: "Tag", deployment: "Deployment") -> None:
    """Print notes about unusual tags, if there are any.

    The first note lists the edge lengths that come from the landmark file, with the number of tags for each. The second
    note has the ids of tags with a corner behind a face of the room, where no camera sees this corner.
    """
    from lmd.core.words import few
    from lmd.geometry.squares import corners

    own = deployment.edges_of(tag)
    other = Counter(edge for edge in own.tolist() if abs(edge - tag.size) > SAME_EDGE)
    if other and tag.edges is None:
        sizes = ", ".join(f"{edge:g} m ({count})" for edge, count in sorted(other.items()))
        holds = f"{len(own) - other.total()} of {len(own)} tags"
        note(f"tag.edge = {tag.size:g} m ({tag.square}) holds for {holds}; the others have their own: {sizes}")
    points = corners(deployment.positions, deployment.normals, deployment.ups, own)
    if len(behind := deployment.ids[~room.contains(points).all(axis=1)]):
        note(f"behind a face of the {room.describe()}, where no camera sees them: {few(behind, 8)}")


def build_optimiser(cfg: DictConfig, seed: int) -> "Optimiser":
    """Build the optimiser of a configuration.

    Raises:
        InputError: the object cannot be built, or is not an `Optimiser`.
    """
    from lmd.core.checks import InputError
    from lmd.optimisers.base import AskTell, Optimiser

    optimiser = instantiate(settings_of(cfg, "optimiser"), seed=seed)
    if not isinstance(optimiser, Optimiser):
        told = f"optimiser._target_ = {cfg.optimiser.get('_target_')!r} makes a {type(optimiser).__name__}"
        raise InputError(f"{told}, which is not derived from lmd.optimisers.base.Optimiser.")
    if isinstance(optimiser, AskTell):
        optimiser.encoding = optimiser.encoding or cfg.encoding.kind
        optimiser.flush = cfg.encoding.flush
    return optimiser


def budget_of(cfg: DictConfig) -> "Budget":
    """Build the budget of a configuration.

    Raises:
        InputError: a limit of the budget is not positive, or no limit is given.
    """
    from lmd.optimisers.ledger import Budget

    budget = settings_of(cfg, "budget")
    with keyed("budget"):
        return Budget(budget.evaluations, budget.seconds)


def seeds_of(cfg: DictConfig) -> range:
    """Seeds of several runs: `seed`, `seed + 1`, ...; the key `seeds` gives their number.

    Raises:
        InputError: `seed` or `seeds` is not an allowed number, or the memory is too small for all runs.
    """
    from lmd.core.checks import integer, seed_number
    from lmd.core.memory import check_memory

    seed, count = seed_number(cfg.seed), integer("seeds", cfg.seeds, low=1)
    check_memory(RUN_BYTES * count, f"seeds = {count} runs", "seeds")
    return range(seed, seed + count)
