"""Gradient ascent of all landmarks together, the last stage of annealing for objectives on random samples of poses.

Random moves of single landmarks do not reach a local optimum, because the gain of a small move is smaller than the
sampling error. The ascent moves all landmarks in each step. A landmark moves along its surface according to its slope:
the derivatives of the objective with respect to the landmark's coordinates u and v on the surface.

The objective f is smoothed (`walk`), and its slope is computed as a central difference with a step d:

    (f(x + d) - f(x - d)) / (2 d).

f is computed on random samples of poses, with occlusion, and the slopes are averaged over the samples. f must have an
incremental evaluator (`lmd.incremental.field`), which computes f after a move of one landmark. d is a few millimetres:
good landmarks are just far enough apart not to hide each other, and with a larger d they would be pushed further apart.
The length of the steps follows Adam (Kingma and Ba, 2015): steps are shorter where samples disagree about the
direction.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, integer
from lmd.core.compiled import kernel
from lmd.core.threads import at_once
from lmd.incremental.field import bound, placed, runner, settle, smoothed
from lmd.objectives.crowd import slope_target, target_of
from lmd.objectives.reference_field import field_of
from lmd.optimisers.stored import WORD, array
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.space.surface import SurfaceArrays

PLACES_TRIED = 4  # number of places at which a landmark is evaluated in each step
DIFFERENCE_M = 3e-3  # step d of the difference quotient, metres
STEP_M = 3e-3, 3e-4  # first and last step of Adam along u and v, metres, if the slope is constant
WIDTH, SHARE = 6e-3, 0.02  # width and share of the smoothed objective, as in `Settings`
MOMENT_DECAY = 0.9, 0.999  # decay per step of the mean slope and of the mean squared slope


@kernel
def slopes(
    first: int, field: Any, state: Any, scratch: Any, target: Any, surfaces: SurfaceArrays, difference: float,
    width: float, out: FloatArray,
) -> None:  # fmt: skip
    """Write the slopes of the smoothed objective, for landmarks from `first` on, into `out`.

    The slopes of a landmark are the derivatives with respect to its coordinates u and v on its surface. The objective
    gives each camera position a value in [0, 1]. Smoothing replaces a threshold on this value by a smooth step.

    Args:
        first: index of the first landmark that is not fixed.
        field: incremental evaluator (`lmd.incremental.field`), which computes the values after a move.
        state: state of the evaluator with the landmarks at their places; it is not changed.
        scratch: working memory of the evaluator.
        target: functions that compute the fitness from the values, a `Target`.
        surfaces: surfaces of the landmarks.
        difference: displacement d of a landmark for the central difference, metres.
        width: width of the smooth step, on the scale of the values.
        out: slopes along u and v of K landmarks, `(K, 2)`, 1/metre.
    """
    units, accepted, known = scratch.units, state.units, placed(state)
    poses = known.poses
    value, pose, place = np.empty(len(accepted)), np.empty(6), np.empty(2)
    for p in range(len(accepted)):
        value[p] = smoothed(target, p, accepted[p], 0.0, width, SHARE)
    for k in range(first, poses.shape[1]):
        s = known.surfaces[k]
        place[:] = 0.0
        for i in range(3):
            offset = poses[i, k] - surfaces.origin[s, i]
            place[0] += offset * surfaces.u[s, i]
            place[1] += offset * surfaces.v[s, i]
        for side in range(2):
            rise = run = 0.0
            for sign in (-1.0, 1.0):
                # The difference ends at the border of the surface, as a landmark beyond the border is not visible.
                away = min(max(place[side] + sign * difference, 0.0), surfaces.extent[s, side]) - place[side]
                for i in range(3):
                    along = surfaces.u[s, i] if side == 0 else surfaces.v[s, i]
                    pose[i], pose[3 + i] = poses[i, k] + away * along, poses[3 + i, k]
                bound(field, k, pose, s, state, scratch)
                settle(field, k, state, scratch)
                run += sign * away
                for p in range(len(accepted)):
                    if units[p] != accepted[p]:
                        rise += sign * (smoothed(target, p, units[p], 0.0, width, SHARE) - value[p])
            out[k, side] = rise / run


def moved_along(problem: Problem, here: Deployment, surfaces: SurfaceArrays, away: FloatArray) -> Deployment:
    """Deployment `here` with its K landmarks moved by `away` `(K, 2)`, metres, along u and v of their surfaces.

    Fixed landmarks do not move. Overlapping footprints are pushed apart; if they find no room, `here` is returned.
    """
    at = surfaces.coordinates(here.surfaces, here.positions) + away
    moved = Deployment(surfaces.points(here.surfaces, at), here.normals, here.surfaces)
    return problem.separated(problem.complete(problem.free(moved))) or here


class Ascent:
    """State of the optimiser Adam: running means of the slopes of K landmarks.

    Args:
        count: number K of landmarks.
    """

    def __init__(self, count: int) -> None:
        self._mean, self._square, self._steps = np.zeros((count, 2)), np.zeros((count, 2)), 0

    def step(
        self, problem: Problem, here: Deployment, progress: float, samples: int, rng: np.random.Generator
    ) -> Deployment:
        """Return the deployment after one step: each landmark of `here` that is not fixed moves along its surface.

        Args:
            problem: problem whose objective is evaluated on random samples of poses.
            here: K landmarks, flush on their surfaces.
            progress: completed fraction of the ascent, in [0, 1]; steps get smaller as this fraction increases.
            samples: number of samples to draw. A sample has one random position in each grid cell. Samples are
                evaluated in parallel threads.
            rng: random generator that draws the samples.
        """
        surfaces = SurfaceArrays.of(problem.scene.footprints.hanging.surfaces())
        seeds = rng.integers(2**63, size=samples)

        def sampled(seed: int) -> FloatArray:
            sample = problem.resampled(0.0, np.random.default_rng(seed))
            assert sample is not None, "the objective has a sampling"
            field = field_of(problem.objective, sample[0])
            state, out = field.state(here), np.zeros((len(here), 2))
            target = slope_target(target_of(problem.objective, field, *sample), state.units)
            scratch = field.scratch(state)
            runner(field, slopes)(
                problem.fixed_count, field, state, scratch, target, surfaces, DIFFERENCE_M, WIDTH, out
            )
            return out

        slope = sum(at_once(problem.evaluator.threads, sampled, seeds)) / samples
        self._steps += 1
        first, second = MOMENT_DECAY
        self._mean = first * self._mean + (1.0 - first) * slope
        self._square = second * self._square + (1.0 - second) * slope**2
        mean, square = self._mean / (1.0 - first**self._steps), self._square / (1.0 - second**self._steps)
        length = STEP_M[0] * (STEP_M[1] / STEP_M[0]) ** progress
        away = length * mean / np.maximum(np.sqrt(square), np.finfo(float).tiny)
        return moved_along(problem, here, surfaces, away)

    def state(self) -> dict[str, Any]:
        """Return the running means of the slopes as plain data, for a checkpoint."""
        return {"mean": self._mean, "square": self._square, "steps": self._steps}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over the running means of another ascent with K landmarks from its `state`.

        Raises:
            InputError: `state` is not the state of an ascent with K landmarks.
        """
        count = len(self._mean)
        self._mean = array("ascent.mean", state["mean"], np.float64, count, 2)
        self._square = array("ascent.square", state["square"], np.float64, count, 2, low=0.0)
        self._steps = integer("ascent.steps", state["steps"], low=0, high=WORD)
