"""Alternating placement of cameras and tags: block coordinate ascent, with an optimiser for each block."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from typing_extensions import override

from lmd.cameras.mounts import MountSpace
from lmd.cameras.problem import CameraProblem
from lmd.core.checks import FloatArray, InputError, integer
from lmd.objectives.base import incremental
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.base import Callback, Optimiser, Result
from lmd.optimisers.ledger import Budget, Ledger
from lmd.optimisers.stored import array, deployment, deployment_state
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import GivenDeployment
from lmd.scene.rig import Mount, Rig


@dataclass(frozen=True)
class _Best:
    """Best tags and cameras of the completed turns."""

    fitness: float
    """Fitness of the tags together with the cameras."""
    tags: Deployment
    """Landmarks."""
    rig: Rig
    """Cameras."""


class Alternating(Optimiser):
    """Alternating placement of cameras and tags.

    A turn optimises the cameras or the tags, from the best result of earlier turns; a result that is not better is
    discarded. The budget of `run` is the budget of each turn of the cameras.

    Args:
        cameras: makes the optimiser for a turn of the cameras from a seed: `seed`, `seed + 1`, ...
        rounds: number of turns of the cameras, and of the tags.
        tag_budget: budget of each turn of the tags, which `Annealing` places.
        seed: see `Optimiser`.

    Raises:
        InputError: a value is out of range.
    """

    def __init__(self, cameras: Callable[[int], Optimiser], rounds: int, tag_budget: Budget, seed: int = 0) -> None:
        super().__init__(seed)
        self.cameras, self.tag_budget = cameras, tag_budget
        self.rounds = integer("rounds", rounds, low=1)
        self.reached: list[float] = []  # best fitness after each completed turn
        self.best: _Best | None = None  # best result of the completed turns
        self.began = 0  # number of records made before the current turn
        self.inner: Optimiser | None = None  # optimiser of the current turn
        self.posed: Problem  # problem of the current turn
        self.space: MountSpace  # mounts of the cameras

    @override
    def state(self) -> dict[str, Any]:
        best = self.best
        return {
            **self.ledger.state(),
            "reached": np.array(self.reached, dtype=np.float64),
            "began": self.began,
            "tags": None if best is None else deployment_state(best.tags),
            "rig": None if best is None else _rig_state(best.rig, self.space),
            "inner": None if self.inner is None else self.inner.state(),
        }

    @override
    def restore(self, state: Mapping[str, Any], problem: Problem) -> None:
        cameras = _cameras(problem)
        self.space = cameras.space
        self.ledger = Ledger.of(state)
        self.reached = array("reached", state["reached"], np.float64, None, low=-math.inf).tolist()
        self.began = integer("began", state["began"], low=0, high=len(self.ledger.history))
        if self.reached:
            tags = problem.labelled(deployment("tags", state["tags"], problem, problem.count))
            self.best = _Best(self.reached[-1], tags, _rig_of(state["rig"], cameras.space))
        if state["inner"] is not None:
            self._begin_turn(cameras)
            assert self.inner is not None
            self.inner.restore(state["inner"], self.posed)
            if len(self.inner.ledger.history) != len(self.ledger.history) - self.began:
                raise InputError("inner has a history that does not belong to the current round.", "inner")

    @override
    def check(self, problem: Problem) -> None:
        self.cameras(self.seed).check(_cameras(problem))
        incremental(problem.objective)

    def figures(self) -> Mapping[str, float]:
        """Best fitness after each turn."""
        reached = [*self.reached, *([self.ledger.best_fitness] if self.inner else [])]
        return {f"round_{1 + i // 2}_{('cameras', 'tags')[i % 2]}": fitness for i, fitness in enumerate(reached)}

    @override
    def run(self, problem: Problem, budget: Budget, callback: Callback | None = None) -> Result:
        cameras = _cameras(problem)
        self.space = cameras.space

        def follow(_: Optimiser) -> bool | None:
            self._follow()
            return callback(self) if callback else None

        while len(self.reached) < 2 * self.rounds:
            if self.inner is None:
                self._begin_turn(cameras)
            assert self.inner is not None
            found = self.inner.run(self.posed, self.tag_budget if len(self.reached) % 2 else budget, follow)
            self._follow()
            if found.stopped == "interrupted":
                return self.result(problem, "interrupted")
            self.best = self._best()
            self.reached.append(self.best.fitness)
            self.inner, self.began = None, len(self.ledger.history)
        return self.result(problem, "budget")

    @override
    def found(self, problem: Problem) -> Deployment | None:
        self._follow()
        return self._best().tags if self.ledger.history else None

    @override
    def found_rig(self, problem: Problem) -> Rig | None:
        return self._best().rig if self.ledger.history else None

    def _begin_turn(self, cameras: CameraProblem) -> None:
        turn, best = len(self.reached), self.best
        seed = self.seed + turn // 2
        if turn % 2:
            assert best is not None
            self.inner = Annealing(seed=seed)
            self.posed = cameras.with_rig(best.rig, GivenDeployment(cameras.free(best.tags)))
        else:
            self.inner = self.cameras(seed)
            self.posed = cameras if best is None else CameraProblem(cameras, best.tags, cameras.space, best.rig)

    def _follow(self) -> None:
        """Copy the new records of the current turn."""
        if self.inner is None:
            return
        ledger, inner = self.ledger, self.inner.ledger
        before = ledger.history[self.began - 1] if self.began else None
        spent, seconds = (before.evaluations, before.wall_time) if before else (0.0, 0.0)
        for record in inner.history[len(ledger.history) - self.began :]:
            ledger.seconds = seconds + record.wall_time
            ledger.note(spent + record.evaluations, record.best_fitness)

    def _best(self) -> _Best:
        """Best of all turns, the current turn included."""
        best, inner = self.best, self.inner
        if inner is not None and inner.ledger.best_fitness > (best.fitness if best else -math.inf):
            found = inner.result(self.posed, "interrupted")
            rig = found.rig or (best.rig if best else None)
            assert rig is not None, "cameras have the first turn"
            best = _Best(found.fitness, found.deployment, rig)
        if best is None:
            raise InputError(f"{type(self).__name__} found no cameras: every evaluation failed.")
        return best


def _cameras(problem: Problem) -> CameraProblem:
    if not isinstance(problem, CameraProblem):
        raise InputError("Alternating places cameras and tags, so it needs a body for the cameras.")
    return problem


def _rig_state(rig: Rig, space: MountSpace) -> FloatArray:
    """Cameras as numbers: index of the lens, position, and angles, `(C, 7)`."""
    lenses = list(space.lenses)
    return np.array([[lenses.index(m.camera), *m.translation, m.yaw, m.pitch, m.roll] for m in rig.mounts])


def _rig_of(state: Any, space: MountSpace) -> Rig:
    """Make a rig from the `_rig_state` of another rig.

    Raises:
        InputError: a camera has a pose in which it must not be mounted.
    """
    numbers = array("rig", state, np.float64, space.count, 7)
    lens = array("rig", numbers[:, 0], np.float64, None, low=0, high=len(space.lenses) - 1)
    mounts = zip(lens.astype(int).tolist(), numbers[:, 1:].tolist(), strict=True)
    rig = Rig(tuple(Mount(space.lenses[i], (x, y, z), *turns) for i, (x, y, z, *turns) in mounts))
    space.genes(rig)
    return rig
