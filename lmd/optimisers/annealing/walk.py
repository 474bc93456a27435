"""The Metropolis walk of simulated annealing: landmarks move, one or a few at a time, on a smoothed objective.

An objective that counts positions whose value reaches a threshold is a staircase, which hides whether a move nearly
qualified a position. The walk climbs a smooth stand-in (`smoothed`); for coverage this is the relevance-weighted mean
over positions of

    1 / (1 + exp(-(P_n - thold_p - margin) / width)) + share * P_n.

It keeps the deployment that is best on the true objective (`worth`). As `width` shrinks the two become the same.

Most moves are rejected, and most of these before they are tried exactly: the objective rises with every value, so with
values at most what `bound` finds, it bounds the gain. If that is a loss, so is the gain, and the random number that
decides is drawn at once. If even the bound is rejected, the gain would be too; otherwise the gain and the same number
decide. So neither decisions nor random numbers depend on the bound.
"""

import math
from typing import NamedTuple

import numpy as np

from lmd.core.compiled import inner, kernel
from lmd.core.layers import layer
from lmd.incremental.field import accept, bound, lead, settle, smoothed, total_worth, undo
from lmd.space.allowed import allows, spread_one

# Relative, for the bound: exp may fall by a rounding error or two where its argument rises.
_SLACK = 1e-12


class Settings(NamedTuple):
    """How the walk behaves while conditions last."""

    temperature: float
    """Loss, in the smoothed objective, that is accepted with probability 1/e."""
    width: float
    """In value, over which the objective is smoothed."""
    margin: float
    """By which the smoothed threshold lies above the true one."""
    share: float
    """Of the value itself that is added."""
    step: float
    """Standard deviation of a local move, metres."""
    jump: float
    """Probability of a move to anywhere."""
    join: float
    """Probability of a move next to another landmark."""
    near: float
    """About how far from the other that is, metres."""
    together: float
    """Probability that a landmark takes its n - 1 nearest neighbours along, unchanged among themselves."""
    exchange: float
    """Probability that, where there are several sizes, a landmark exchanges its place with one of another size."""


class Papers(NamedTuple):
    """The papers of K landmarks: moves that let two overlap, or lead where one may not hang, are not even tried."""

    edges: np.ndarray
    """Of the papers, `(K,)`, metres; 0 for points."""
    of: np.ndarray
    """Which of S sizes each has, `(K,)`."""
    pieces: np.ndarray
    """Where landmarks of each size may hang, in the coordinates of the walk's surfaces, `(T, 6)`: `SurfaceArrays`."""
    first: np.ndarray
    """From and to which piece that is on each surface, `(S, W + 1)`."""


class Best(NamedTuple):
    """The best deployment met: fitness `(1,)`, landmarks and normals `(3, K)`, surfaces `(K,)`."""

    fitness: np.ndarray
    landmarks: np.ndarray
    normals: np.ndarray
    surfaces: np.ndarray


@inner
def _reflect(value, extent):
    """Fold a coordinate that left [0, extent] back into it."""
    value = abs(value) % (2.0 * extent)
    return 2.0 * extent - value if value > extent else value


@inner
def _propose(k, state, surfaces, settings, rng):
    """A new place for landmark k, flush on a surface: index of the surface and coordinates there."""
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
        near, step = int(rng.random() * state.landmarks.shape[1]), settings.near
    s = state.surfaces[near]
    a, b = rng.normal() * step, rng.normal() * step
    for i in range(3):
        offset = state.landmarks[i, near] - surfaces.origin[s, i]
        a += offset * surfaces.u[s, i]
        b += offset * surfaces.v[s, i]
    return s, _reflect(a, surfaces.extent[s, 0]), _reflect(b, surfaces.extent[s, 1])


@inner
def _gather(k, members, state, group):
    """Fill `group` with landmark k and its nearest neighbours among the `members`."""
    group[0] = k
    for m in range(1, len(group)):
        nearest = np.inf
        for j in members:
            distance = 0.0
            for i in range(3):
                distance += (state.landmarks[i, j] - state.landmarks[i, k]) ** 2
            taken = False
            for other in group[:m]:
                taken = taken or other == j
            if distance < nearest and not taken:
                nearest, group[m] = distance, j


@inner
def propose(group, state, surfaces, papers, settings, rng, new, on):
    """Write where the landmarks of `group` shall go: position and normal, `(len(group), 6)`, and the surface.

    The first goes to a proposed place, the others keep their offset from it in surface coordinates.

    Returns:
        whether all may hang where they would go.
    """
    k = group[0]
    before = state.surfaces[k]
    s, a, b = _propose(k, state, surfaces, settings, rng)
    for m in range(len(group)):
        da = db = 0.0
        for i in range(3):
            offset = state.landmarks[i, group[m]] - state.landmarks[i, k]
            da += offset * surfaces.u[before, i]
            db += offset * surfaces.v[before, i]
        am, bm = _reflect(a + da, surfaces.extent[s, 0]), _reflect(b + db, surfaces.extent[s, 1])
        if not _may_hang(group[m], s, am, bm, papers):
            return False
        on[m] = s
        for i in range(3):
            new[m, i] = surfaces.origin[s, i] + am * surfaces.u[s, i] + bm * surfaces.v[s, i]
            new[m, 3 + i] = surfaces.normal[s, i]
    return True


@inner
def _may_hang(k, s, a, b, papers):
    """Whether landmark k may hang at (a, b) on surface s, if it is one."""
    first = papers.first[papers.of[k]]
    return s >= 0 and allows(papers.pieces, first[s], first[s + 1], a, b)


@inner
def _pair(k, members, papers, rng, pair):
    """Fill `pair` with landmark k and one of the `members` whose size is another; whether there is one."""
    start = int(rng.random() * len(members))
    for i in range(len(members)):
        j = members[(start + i) % len(members)]
        if papers.of[j] != papers.of[k]:
            pair[0], pair[1] = k, j
            return True
    return False


@inner
def _exchange(pair, state, surfaces, papers, new, on):
    """Propose that the landmarks of `pair` exchange their places; arguments and result as of `propose`."""
    for m in range(2):
        other = pair[1 - m]
        s, a, b = state.surfaces[other], 0.0, 0.0
        for i in range(3):
            new[m, i], new[m, 3 + i] = state.landmarks[i, other], state.normals[i, other]
            offset = new[m, i] - surfaces.origin[s, i]
            a, b = a + offset * surfaces.u[s, i], b + offset * surfaces.v[s, i]
        if not _may_hang(pair[m], s, a, b, papers):
            return False
        on[m] = s
    return True


@inner
def _overlap(group, on, new, state, surfaces, papers):
    """Whether a plate of `group` at its `new` place on its surface would overlap another there."""
    landmarks, edges = state.landmarks, papers.edges
    for m in range(len(group)):
        surface, mine = on[m], edges[group[m]]
        u, v = surfaces.u[surface], surfaces.v[surface]
        for j in range(landmarks.shape[1]):
            if state.surfaces[j] != surface:
                continue
            along = up = 0.0
            for i in range(3):
                away = landmarks[i, j] - new[m, i]
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


@inner
def _sum_values(units, accepted, value, target, settings, trial):
    """The smoothed objective for `units`, its terms in `trial`; `value` has those for `accepted`."""
    total = 0.0
    for p in range(len(units)):
        trial[p] = value[p]
        if units[p] != accepted[p]:
            trial[p] = smoothed(target, p, units[p], settings.margin, settings.width, settings.share)
        total += trial[p]
    return total


@inner
def _keep_best(state, target, best):
    """Update `best` if `state` is better."""
    fitness = total_worth(target, state.units)
    if fitness > best.fitness[0]:
        best.fitness[0] = fitness
        for k in range(len(state.surfaces)):
            best.surfaces[k] = state.surfaces[k]
            for i in range(3):
                best.landmarks[i, k], best.normals[i, k] = state.landmarks[i, k], state.normals[i, k]


@inner
def _try(group, on, new, field, state, scratches, target, settings, rng, known):
    """Move the landmarks of `group` to their `new` places on the surfaces `on`, if the random numbers say so.

    `known` is what the walk knows of the smoothed objective: its total, accepted units, their terms, and room for those
    that are tried. Returns the total then, and whether they were moved.
    """
    total, accepted, value, trial = known
    last = len(group) - 1
    for m in range(last + 1):
        k, scratch = group[m], layer(scratches, m)
        bound(field, k, new[m], on[m], state, scratch)
        most = drawn = 0.0
        if m == last:
            most = _sum_values(scratch.units, accepted, value, target, settings, trial) - total
            most += _SLACK * (1.0 + settings.share)
            drawn = rng.random() if most < 0.0 else -1.0
            if drawn >= math.exp(min(most, 0.0) / settings.temperature) * (1.0 + _SLACK):
                break
        settle(field, k, state, scratch)
        if m == last:
            sum_value = _sum_values(scratch.units, accepted, value, target, settings, trial)
            gain = sum_value - total
            if gain < 0.0 <= most:
                drawn = rng.random()
            if gain < 0.0 and drawn >= math.exp(gain / settings.temperature):
                break
        accept(field, k, state, scratch)
        if m == last:
            return sum_value, True
    for m in range(last - 1, -1, -1):
        undo(field, group[m], state, layer(scratches, m))
    return total, False


@kernel
def walk(moves, places, members, several, field, state, scratches, target, surfaces, papers, settings, rng, best):
    """Move landmarks `moves` times from `places`; `state` ends where the walk ends, and `best` is updated.

    Args:
        moves: landmarks that are moved in all.
        places: where the walk begins, see `Places`; nothing moves to an empty one.
        members: the landmarks that may move, at least as many as can move together.
        several: for those that do, as many as can.
        field, target: what is climbed.
        state: of the field.
        scratches: `layers` of one, at least as many as landmarks can move together, two for an exchange.
        surfaces: where landmarks may hang.
        papers: see `Papers`; moves that are not even tried count.
        settings: see `Settings`.
        rng: the source of all random numbers.
        best: see `Best`.
    """
    # Here, not in a kernel of its own: what moves landmarks is compiled once. And by inner functions alone, as for
    # numba what a kernel calls by itself is something else.
    lead(places, field, state, scratches, np.empty(6))
    positions, count = len(state.units), len(members)
    accepted = state.units.copy()
    value, trial = np.empty(positions), np.empty(positions)
    single, pair = np.empty(1, dtype=np.int64), np.empty(2, dtype=np.int64)
    new, on = np.empty((max(len(several), 2), 6)), np.empty(max(len(several), 2), dtype=np.int64)
    sizes = len(papers.first)
    total = 0.0
    for p in range(positions):
        value[p] = smoothed(target, p, accepted[p], settings.margin, settings.width, settings.share)
        total += value[p]
    moved = 0
    while moved < moves:
        group = single
        group[0] = members[int(rng.random() * count)]
        exchanges = sizes > 1 and moves - moved >= 2 and rng.random() < settings.exchange
        if exchanges and _pair(group[0], members, papers, rng, pair):
            group = pair
            possible = _exchange(group, state, surfaces, papers, new, on)
        else:
            if moves - moved >= len(several) > 1 and rng.random() < settings.together:
                _gather(group[0], members, state, several)
                group = several
            possible = propose(group, state, surfaces, papers, settings, rng, new, on)
        moved += len(group)
        if not possible or (papers.edges[0] > 0.0 and _overlap(group, on, new, state, surfaces, papers)):
            continue
        known = (total, accepted, value, trial)
        total, taken = _try(group, on, new, field, state, scratches, target, settings, rng, known)
        if taken:
            for p in range(positions):
                accepted[p] = state.units[p]
            value, trial = trial, value
            _keep_best(state, target, best)
