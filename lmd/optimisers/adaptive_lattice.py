"""Adaptive candidates for the integer program of `lattice`: the lattice is refined where the solution lies.

The idea is the local search of adaptive camera placement, there called explore and exploit (arXiv 2411.17942).
"""

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from typing_extensions import override

from lmd.core.checks import BoolArray, IntArray, real
from lmd.optimisers.lattice import Program, chosen_poses, covers_of, without_touching
from lmd.optimisers.lattice_search import LatticeSearch, Round
from lmd.optimisers.stored import deployment, deployment_state
from lmd.problem import Problem
from lmd.scene.deployment import Deployment

AROUND = np.array([step for step in product((-1.0, 0.0, 1.0), repeat=2) if any(step)])  # neighbours, in pitches
EQUAL_M = 1e-6  # poses closer than this are one candidate, metres


class AdaptiveLattice(LatticeSearch):
    """Rounds on the lattice and the neighbours of the chosen poses on their surfaces.

    The first round has the lattice alone. Each later round adds the eight neighbours of each chosen pose at a pitch,
    which begins at half the spacing and is halved when neither the fitness nor the value of the program has risen. A
    choice is kept unless its fitness with occlusion is lower. No random numbers are drawn after the start.

    Args:
        spacing: spacing of the lattice, metres.
        finest: smallest pitch, metres; the run ends when a round at a smaller one would follow.
        nodes: largest number of nodes in the solver's tree in each round.
        margin: see `LatticeSearch`.
        seed: see `LatticeSearch`.

    Raises:
        InputError: a parameter is out of range.
    """

    def __init__(
        self, spacing: float = 1.0, finest: float = 0.05, nodes: int = 20, margin: float = 0.0, seed: int = 0
    ) -> None:
        super().__init__(spacing, nodes, margin, seed)
        self.finest = real("finest", finest, above=0.0, high=spacing)
        self.pitch = self.spacing  # of the neighbours in the next round; the spacing for none
        self.chosen: Deployment  # poses of the free landmarks
        self.value = self.fitness = 0.0  # of the chosen poses: in the program, and with occlusion

    @override
    def _begin(self, problem: Problem, taken: IntArray, fitness: float) -> None:
        self.chosen, self.fitness = chosen_poses(problem, self.lattice, taken), fitness

    @override
    def _next(self, problem: Problem) -> Round:
        own = _unlike(self.chosen, self.lattice)
        new = _unlike(_around(problem, self.chosen, self.pitch), self.lattice, *own) if self._refines else []
        added, poses = [*own, *new], self.lattice
        for part in added:
            poses = poses + part

        def make() -> tuple[Program, None, None]:
            covers = np.concatenate([self.covers, *(covers_of(problem, part) for part in added)], axis=-1)
            return Program.of(problem, poses, covers, self.margin), None, None

        return Round(sum(map(len, new)), poses, make)

    @property
    def _refines(self) -> bool:
        return self.pitch < self.spacing

    @override
    def _accept(self, problem: Problem, poses: Deployment, taken: IntArray, value: float, fitness: float) -> None:
        better = fitness >= self.fitness
        rises = better and (fitness > self.fitness or value > self.value)
        if better:
            self.chosen, self.value, self.fitness = chosen_poses(problem, poses, taken), value, fitness
        if not rises or not self._refines:
            self.pitch /= 2.0

    @override
    def _failed(self) -> None:
        self.pitch /= 2.0

    @override
    def _ended(self) -> bool:
        return self.pitch < self.finest

    @override
    def state(self) -> dict[str, Any]:
        state = super().state()
        if self.ledger.history:
            state |= {"chosen": deployment_state(self.chosen), "pitch": self.pitch}
            state |= {"value": self.value, "fitness": self.fitness}
        return state

    @override
    def restore(self, state: Mapping[str, Any], problem: Problem) -> None:
        super().restore(state, problem)
        if not self.ledger.history:
            return
        chosen = deployment("chosen", state["chosen"], problem, problem.free_count)
        self.chosen = replace(chosen, edges=problem.free_edges)
        self.pitch = real("pitch", state["pitch"], above=0.0, high=self.spacing)
        self.value = real("value", state["value"], low=0.0, high=1.0)
        self.fitness = real("fitness", state["fitness"], low=0.0, high=1.0)


def _around(problem: Problem, chosen: Deployment, pitch: float) -> Deployment:
    """Neighbours of poses on their surfaces, where landmarks of their size may hang, `pitch` metres apart."""
    footprints, parts = problem.scene.footprints, None
    papers = footprints.papers(chosen)
    for paper in np.unique(papers):
        these = chosen[papers == paper][np.repeat(np.arange((papers == paper).sum()), len(AROUND))]
        surfaces = footprints.surfaces_of(float(paper))
        at = surfaces.coordinates(these.surfaces, these.positions) + pitch * np.tile(AROUND, (len(these) // 8, 1))
        part = replace(these, positions=surfaces.points(these.surfaces, at))
        parts = part if parts is None else parts + part
    assert parts is not None, "there are landmarks to place"
    return without_touching(problem, parts)


def _unlike(poses: Deployment, *others: Deployment) -> list[Deployment]:
    """The poses that are no other's and no earlier one's, as a list of one deployment, or of none."""
    keys = _keys(poses)
    _, first = np.unique(keys, axis=0, return_index=True)
    new: BoolArray = np.isin(np.arange(len(poses)), first)
    for other in others:
        known = set(map(tuple, _keys(other).tolist()))
        new &= np.array([tuple(key) not in known for key in keys.tolist()])
    return [poses[new]] if new.any() else []


def _keys(poses: Deployment) -> IntArray:
    """Numbers that are equal for equal poses, `(N, 5)`."""
    size = np.nan_to_num(poses.edges)
    numbers = np.column_stack([poses.positions, size]) / EQUAL_M
    return np.column_stack([np.rint(numbers).astype(np.int64), poses.surfaces])
