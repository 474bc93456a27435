"""Where the landmarks of the walk (`lmd.optimisers.annealing.walk`) go next: the moves it proposes."""

from typing import NamedTuple

import numpy as np

from lmd.core.compiled import inner
from lmd.space.allowed import allows, spread_one


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


@inner
def _reflect(value, extent):
    """Fold a coordinate that left [0, extent] back into it."""
    value = abs(value) % (2.0 * extent)
    return 2.0 * extent - value if value > extent else value


@inner
def _propose(k, here, surfaces, settings, rng):
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
        near, step = int(rng.random() * here.poses.shape[1]), settings.near
    s = here.surfaces[near]
    a, b = rng.normal() * step, rng.normal() * step
    for i in range(3):
        offset = here.poses[i, near] - surfaces.origin[s, i]
        a += offset * surfaces.u[s, i]
        b += offset * surfaces.v[s, i]
    return s, _reflect(a, surfaces.extent[s, 0]), _reflect(b, surfaces.extent[s, 1])


@inner
def gather(k, members, poses, group):
    """Fill `group` with landmark k and its nearest neighbours among the `members`."""
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
def propose(group, here, surfaces, papers, settings, rng, new, on):
    """Write where the landmarks of `group` shall go: position and normal, `(len(group), 6)`, and the surface.

    The first goes to a proposed place, the others keep their offset from it in surface coordinates. `here` has the
    `poses` and `surfaces` of all landmarks.

    Returns:
        whether all may hang where they would go.
    """
    k = group[0]
    before = here.surfaces[k]
    s, a, b = _propose(k, here, surfaces, settings, rng)
    for m in range(len(group)):
        da = db = 0.0
        for i in range(3):
            offset = here.poses[i, group[m]] - here.poses[i, k]
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
def pair_up(k, members, papers, rng, pair):
    """Fill `pair` with landmark k and one of the `members` whose size is another; whether there is one."""
    start = int(rng.random() * len(members))
    for i in range(len(members)):
        j = members[(start + i) % len(members)]
        if papers.of[j] != papers.of[k]:
            pair[0], pair[1] = k, j
            return True
    return False


@inner
def exchange(pair, here, surfaces, papers, new, on):
    """Propose that the landmarks of `pair` exchange their places; arguments and result as of `propose`."""
    for m in range(2):
        other = pair[1 - m]
        s, a, b = here.surfaces[other], 0.0, 0.0
        for i in range(3):
            new[m, i], new[m, 3 + i] = here.poses[i, other], here.poses[3 + i, other]
            offset = new[m, i] - surfaces.origin[s, i]
            a, b = a + offset * surfaces.u[s, i], b + offset * surfaces.v[s, i]
        if not _may_hang(pair[m], s, a, b, papers):
            return False
        on[m] = s
    return True


@inner
def overlap(group, on, new, here, surfaces, papers):
    """Whether a plate of `group` at its `new` place on its surface would overlap another there."""
    poses, edges = here.poses, papers.edges
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
