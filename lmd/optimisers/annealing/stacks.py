"""Stacks: landmarks that hang on one point, as if nothing hid anything, until they are pulled apart."""

import math

import numpy as np

from lmd.core.checks import FloatArray
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.space.surface import SurfaceArrays

STACK_SPREAD = 1.6  # virtual diameters between the landmarks of a stack pulled apart: they no longer hide each other


def count_stacks(problem: Problem, stack: int) -> int:
    """How many stacks of `stack` landmarks there are; what is left over is in none."""
    return problem.free_count // stack if stack else 0


def pulled_apart(problem: Problem, stacks: Deployment, angles: FloatArray, stack: int, distance: float) -> Deployment:
    """The landmarks of stacks, each on a circle around its stack on which neighbours are `distance` apart.

    Args:
        stacks: where S of them are.
        angles: of the first landmark of each, `(S,)`, radians.
        stack: landmarks of each.
        distance: metres.
    """
    surfaces = SurfaceArrays.of(problem.scene.plates.hanging.surfaces())
    radius = 0.0 if stack == 1 else distance / (2.0 * math.sin(math.pi / stack))
    angle = angles[:, None] + 2.0 * np.pi * np.arange(stack) / stack
    offsets = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    at = surfaces.coordinates(stacks.surfaces, stacks.positions)[:, None] + offsets
    of = np.repeat(stacks.surfaces, stack)
    return Deployment(surfaces.points(of, at.reshape(-1, 2)), surfaces.normal[of], of)
