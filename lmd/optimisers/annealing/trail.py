"""Where a walk on samples has been lately, on average.

On samples drawn anew the walk never comes to rest: each step is right for its sample only, and the next sample leads
back again. The mean of where it has been is nearer to what all samples agree on than any place on the way. Later places
weigh more, since the walk still improves: averaging of polynomial decay (Shamir and Zhang, 2013).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.optimisers.stored import array, points
from lmd.problem import Problem
from lmd.scene.deployment import Deployment

AVERAGING_ETA = 3  # eta: at any time the last quarter of the way has half of the weight or more
RESTART_M = 0.5  # metres: a landmark that goes so far from its mean at once begins anew


class Trail:
    """The weighted mean of the places of each landmark since it last jumped, or came to another surface.

    Args:
        start: K landmarks.
    """

    def __init__(self, start: Deployment) -> None:
        self._mean: FloatArray = start.positions.copy()
        self._surfaces = start.surfaces
        self._places = np.zeros(len(start))

    def add(self, here: Deployment) -> Deployment:
        """Go on to `here`; returns the mean, which has its surfaces."""
        away = here.positions - self._mean
        jumped = (here.surfaces != self._surfaces) | (np.linalg.norm(away, axis=1) > RESTART_M)
        self._places = np.where(jumped, 1.0, self._places + 1.0)
        self._surfaces = here.surfaces
        self._mean = self._mean + ((AVERAGING_ETA + 1.0) / (self._places + AVERAGING_ETA))[:, None] * away
        return Deployment(self._mean, here.normals, here.surfaces)

    def state(self) -> dict[str, Any]:
        """The trail as data."""
        return {"mean": self._mean, "surfaces": self._surfaces, "places": self._places}

    def restore(self, state: Mapping[str, Any], problem: Problem) -> None:
        """Take over the `state` of another of as many landmarks in the room of `problem`.

        Raises:
            InputError: it is none.
        """
        count = len(self._places)
        self._mean = points("trail.mean", state["mean"], problem, count)
        self._surfaces = array("trail.surfaces", state["surfaces"], np.int64, count)
        self._places = array("trail.places", state["places"], np.float64, count, low=0.0)
