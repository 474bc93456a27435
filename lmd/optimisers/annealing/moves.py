"""Random moves of landmarks for simulated annealing, and the settings of these moves.

Simulated annealing (`walk`) proposes a move of one or several landmarks, and then accepts or rejects this move. `Stage`
has the settings of a stage of the annealing, such as temperatures and step sizes.

The functions have common arguments. `here` holds the poses and surfaces of all K landmarks. `group` `(G,)` has the
indices of the G landmarks that are to move. Results are written to `new` `(G, 6)`, the new poses of these landmarks
(position and normal), and to `on` `(G,)`, the indices of their new surfaces.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Annotated, Any, NamedTuple

import numpy as np

from lmd.core.checks import Checked, Finite, FloatArray, IntArray, NotNegative, Share, argument_of, choice, real, vector
from lmd.core.compiled import inner
from lmd.incremental.field import Places
from lmd.space.allowed import allows, spread_one
from lmd.space.surface import SurfaceArrays


class Settings(NamedTuple):
    """Settings of simulated annealing during one phase, a number of moves for which they are constant."""

    temperature: float
    """Temperature: the loss in the smoothed objective that is accepted with probability 1/e."""
    width: float
    """Width of the smooth step that replaces the threshold, on the scale of the values, 0 to 1."""
    margin: float
    """Distance of the middle of the smooth step above the true threshold, on the scale of the values, 0 to 1."""
    share: float
    """Factor with which the value itself is added to the smooth step."""
    step: float
    """Standard deviation of a local move along u and along v, metres."""
    jump: float
    """Probability of a move to a place drawn uniformly from all surfaces."""
    join: float
    """Probability of a move to a place near another landmark."""
    near: float
    """For a move to a place near another landmark: standard deviation of the distance from that landmark, along u and
    along v, metres.
    """
    together: float
    """Probability that a landmark and its n - 1 nearest neighbours move together, with unchanged offsets."""
    exchange: float
    """Probability that a landmark exchanges its place with a landmark of another size, if there are several sizes."""


class FootprintArrays(NamedTuple):
    """Footprints of K landmarks, and the regions where landmarks may hang, in arrays.

    A footprint is the square that a landmark covers on its surface. There is a region for each of S sizes of landmarks
    on each of W surfaces. The regions are divided into T trapezoids in all. A move is not tried if footprints would
    overlap, or if a landmark would leave its regions.
    """

    edges: FloatArray
    """Edge length of the footprint of each landmark, `(K,)`, metres; 0 for points."""
    of: IntArray
    """Index of the size of each landmark, `(K,)`."""
    pieces: FloatArray
    """Trapezoids in which landmarks of a size may hang, `(T, 6)`, with columns as in `SurfaceArrays.pieces`."""
    first: IntArray
    """Ranges of the trapezoids, `(S, W + 1)`: the indices for size s on surface w are `first[s, w]` to `first[s, w + 1]
    - 1`.
    """


@inner
def _reflect(value: float, extent: float) -> float:
    """Reflect a coordinate at 0 and at `extent` until it lies in [0, extent]."""
    value = abs(value) % (2.0 * extent)
    return 2.0 * extent - value if value > extent else value


@inner
def _place(
    k: int, here: Places, surfaces: SurfaceArrays, settings: Settings, rng: np.random.Generator
) -> tuple[int, float, float]:
    """Draw a random place for a move of landmark k.

    Returns:
        index of a surface, and coordinates along u and v of that surface, metres.
    """
    kind = rng.random()
    if kind < settings.jump:
        t, drawn = 0, rng.random()
        while t < len(surfaces.shares) - 1 and drawn > surfaces.shares[t]:
            t += 1
        x, y, piece = rng.random(), rng.random(), surfaces.pieces[t]
        a, b = spread_one(piece[0], piece[1], piece[2], piece[3], piece[4], piece[5], x, y)
        return surfaces.of_piece[t], a, b
    near, step = k, settings.step
    if kind < settings.jump + settings.join:
        near, step = int(rng.random() * here.poses.shape[1]), settings.near
    s = here.surfaces[near]
    a, b = rng.normal() * step, rng.normal() * step
    for i in range(3):
        offset = here.poses[i, near] - surfaces.origin[s, i]
        a += offset * surfaces.u[s, i]
        b += offset * surfaces.v[s, i]
    return s, _reflect(a, surfaces.extent[s, 0]), _reflect(b, surfaces.extent[s, 1])


@inner
def gather(k: int, members: IntArray, poses: FloatArray, group: IntArray) -> None:
    """Fill `group` with the indices of landmark k and of its nearest neighbours among the `members`.

    `members` are the indices of the landmarks that may move. `poses` `(6, K)` are the poses of all landmarks.
    """
    group[0] = k
    for m in range(1, len(group)):
        nearest = np.inf
        for j in members:
            distance = 0.0
            for i in range(3):
                way = poses[i, j] - poses[i, k]
                distance += way * way
            taken = False
            for other in group[:m]:
                taken = taken or other == j
            if distance < nearest and not taken:
                nearest, group[m] = distance, j


@inner
def propose(
    group: IntArray, here: Places, surfaces: SurfaceArrays, footprints: FootprintArrays, settings: Settings,
    rng: np.random.Generator, new: FloatArray, on: IntArray,
) -> bool:  # fmt: skip
    """Propose new poses for the landmarks in `group`: the first gets a random place, the others move along with it.

    The others keep their offsets from the first landmark along u and v, the axes of a surface. The proposed poses
    (position and normal) are written to `new` `(G, 6)`, the indices of surfaces to `on` `(G,)`.

    Returns:
        True if all landmarks may hang at their new places.
    """
    k = group[0]
    before = here.surfaces[k]
    s, a, b = _place(k, here, surfaces, settings, rng)
    for m in range(len(group)):
        da = db = 0.0
        for i in range(3):
            offset = here.poses[i, group[m]] - here.poses[i, k]
            da += offset * surfaces.u[before, i]
            db += offset * surfaces.v[before, i]
        am, bm = _reflect(a + da, surfaces.extent[s, 0]), _reflect(b + db, surfaces.extent[s, 1])
        if not _may_hang(group[m], s, am, bm, footprints):
            return False
        on[m] = s
        for i in range(3):
            new[m, i] = surfaces.origin[s, i] + am * surfaces.u[s, i] + bm * surfaces.v[s, i]
            new[m, 3 + i] = surfaces.normal[s, i]
    return True


@inner
def _may_hang(k: int, s: int, a: float, b: float, footprints: FootprintArrays) -> bool:
    """True if landmark k may hang at (a, b), metres along u and v of surface s; False if s is negative (no surface)."""
    first = footprints.first[footprints.of[k]]
    return s >= 0 and allows(footprints.pieces, first[s], first[s + 1], a, b)


@inner
def pair_up(k: int, members: IntArray, footprints: FootprintArrays, rng: np.random.Generator, pair: IntArray) -> bool:
    """Write the indices of landmark k and of a random landmark of another size into `pair`.

    `members` are the indices of the landmarks that may move. Return True if one has another size than k.
    """
    start = int(rng.random() * len(members))
    for i in range(len(members)):
        j = members[(start + i) % len(members)]
        if footprints.of[j] != footprints.of[k]:
            pair[0], pair[1] = k, j
            return True
    return False


@inner
def exchange(
    pair: IntArray, here: Places, surfaces: SurfaceArrays, footprints: FootprintArrays, new: FloatArray, on: IntArray
) -> bool:
    """Propose that the two landmarks of `pair` exchange their places.

    The proposed poses (position and normal) are written to `new` `(2, 6)`, the surfaces to `on` `(2,)`.

    Returns:
        True if both landmarks may hang at their new places.
    """
    for m in range(2):
        other = pair[1 - m]
        s, a, b = here.surfaces[other], 0.0, 0.0
        for i in range(3):
            new[m, i], new[m, 3 + i] = here.poses[i, other], here.poses[3 + i, other]
            offset = new[m, i] - surfaces.origin[s, i]
            a, b = a + offset * surfaces.u[s, i], b + offset * surfaces.v[s, i]
        if not _may_hang(pair[m], s, a, b, footprints):
            return False
        on[m] = s
    return True


@inner
def overlap(
    group: IntArray, on: IntArray, new: FloatArray, here: Places, surfaces: SurfaceArrays, footprints: FootprintArrays
) -> bool:
    """True if the footprint of a landmark in `group` would overlap another footprint after a move.

    The move gives the landmarks of `group` the poses `new` `(G, 6)` on the surfaces `on` `(G,)`. All other landmarks
    have the poses in `here`.
    """
    poses, edges = here.poses, footprints.edges
    for m in range(len(group)):
        surface, mine = on[m], edges[group[m]]
        u, v = surfaces.u[surface], surfaces.v[surface]
        for j in range(poses.shape[1]):
            if here.surfaces[j] != surface:
                continue
            along = up = 0.0
            for i in range(3):
                away = poses[i, j] - new[m, i]
                along, up = along + away * u[i], up + away * v[i]
            if max(abs(along), abs(up)) < (mine + edges[j]) / 2.0:
                stays = True
                for other in group:
                    stays = stays and other != j
                if stays:
                    return True
        for other in range(m):
            along = up = 0.0
            for i in range(3):
                away = new[other, i] - new[m, i]
                along, up = along + away * u[i], up + away * v[i]
            if on[other] == surface and max(abs(along), abs(up)) < (mine + edges[group[other]]) / 2.0:
                return True
    return False


PAIRS = ("temperature", "width", "step")
CONSTANTS = ("margin", "share", "jump", "join", "together", "exchange")


Course = Annotated[Sequence[float], partial(vector, size=2, above=0.0)]


@dataclass(frozen=True)
class Stage(Checked):
    """Settings (conditions) of one stage of simulated annealing.

    A setting that is a pair of numbers changes during the stage from the first number to the second, with geometric
    interpolation.

    Raises:
        InputError: a value is out of range.
    """

    temperature: Course
    """Temperature: the loss in the smoothed objective that is accepted with probability 1/e; the objective is a mean
    over positions.
    """
    width: Course
    """Width of the smooth step that replaces the threshold, on the scale of the values, 0 to 1."""
    step: Course
    """Standard deviation of a local move along u and along v, metres."""
    margin: Finite = 0.0
    """Distance of the middle of the smooth step above the threshold, on the scale of the values, 0 to 1."""
    share: NotNegative = 0.02
    """Factor with which the value of a position is added to its smooth step."""
    jump: Share = 0.1
    """Probability of a move to a place drawn uniformly from all surfaces."""
    join: float = 0.1
    """Probability of a move to a place near another landmark."""
    together: Share = 0.0
    """Probability that a landmark and its n - 1 nearest neighbours move together, with unchanged offsets."""
    exchange: Share = 0.05
    """Probability that a landmark exchanges its place with a landmark of another size, if there are several sizes."""

    def _validate(self) -> None:
        real("join", self.join, low=0.0, high=1.0 - self.jump)

    def settings(self, progress: float, near: float) -> Settings:
        """Return the settings of the next phase when a fraction `progress` of the stage is completed.

        Args:
            progress: completed fraction of the stage, clipped to [0, 1].
            near: value of `Settings.near`, the size of moves to a place near another landmark, metres.
        """
        progress = max(0.0, min(progress, 1.0))
        now = {name: getattr(self, name) for name in CONSTANTS}
        for name in PAIRS:
            first, last = getattr(self, name)
            now[name] = float(first * (last / first) ** progress)
        return Settings(near=near, **now)


STACKED_STAGE = Stage(temperature=(2e-3, 1e-5), width=(0.06, 0.003), step=(1.0, 0.1), jump=0.1, join=0.0)
SINGLE_STAGE = Stage(
    temperature=(2e-5, 2e-6), width=(0.006, 0.002), step=(0.1, 0.01), jump=0.03, join=0.05, together=0.3
)
SAMPLED_STAGE = replace(SINGLE_STAGE, width=(0.02, 0.004), share=0.2)
GIVEN_STAGE = replace(SINGLE_STAGE, temperature=(1e-4, 2e-6), width=(0.02, 0.002), step=(0.3, 0.01))
# A greedy start is good: less heat keeps what was chosen, and more jumps find the places that the choice has missed.
# Single tags are not bound to the places of others as the tags of a cluster are, so their last steps stay larger.
CHOSEN_STAGE = replace(GIVEN_STAGE, temperature=(5e-5, 2e-6), step=(0.3, 0.05), jump=0.1, join=0.1)
# Refines the choice of `greedy`. For coverage by hundreds of tags this is better than `CHOSEN_STAGE`.
REFINING_STAGE = Stage(temperature=(4e-5, 2e-5), width=(0.02, 0.006), step=(0.3, 0.05), margin=0.002, share=0.1)


def changed(name: str, default: Stage, given: Stage | Mapping[str, Any]) -> Stage:
    """Return the stage that an argument of an optimiser describes.

    The result is `given` if it is a `Stage`. If `given` is a mapping, the result is `default` with the fields of the
    mapping replaced. `name` is the name of the argument in messages.

    Raises:
        InputError: a value is out of range, or a key of the mapping is not a field of `Stage`.
    """
    if isinstance(given, Stage):
        return given
    with argument_of(name):
        for key in given:
            choice("condition", key, [field.name for field in fields(Stage)])
        return replace(default, **given)
