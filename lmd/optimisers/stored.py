"""Random generators and deployments as plain data for checkpoints, and checks of data that are read from checkpoints.

A checkpoint may have been written by an attacker, and compiled functions do not check indices, so each value is
checked.
"""

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from lmd.core.checks import FloatArray, InputError, integer
from lmd.problem import Problem
from lmd.scene.deployment import POSE_FIELDS, Deployment
from lmd.space.surface import NEAR_SURFACE

LARGEST = sys.float_info.max
WORD, STATE = 2**32 - 1, 2**128 - 1  # largest numbers of 32 and of 128 bits


def array(
    name: str,
    value: Any,
    dtype: DTypeLike,
    *shape: int | None,
    low: float | FloatArray = -LARGEST,
    high: float | FloatArray = LARGEST,
) -> np.ndarray:
    """Return `value`, checked to be an array of the given type and shape with all elements in [low, high].

    None in `shape` stands for any length; `name` is the name of the value in messages.

    Raises:
        InputError: `value` is not an array of this type and shape, or an element is NaN or out of range.
    """
    wanted = f"{np.dtype(dtype)} of shape ({', '.join('N' if size is None else str(size) for size in shape)})"
    if not isinstance(value, np.ndarray):
        raise InputError(f"{name} must be {wanted}, got a {type(value).__name__}.", name)
    fits = value.ndim == len(shape) and all(s in (None, n) for s, n in zip(shape, value.shape, strict=True))
    if value.dtype != dtype or not fits:
        raise InputError(f"{name} must be {wanted}, got {value.dtype} of shape {value.shape}.", name)
    if (wrong := value[~((low <= value) & (value <= high))]).size:
        raise InputError(f"{name} must not have the value {wrong[0]}.", name)
    return value


def generator_state(rng: np.random.Generator) -> dict[str, Any]:
    """Return the state of a random generator as plain data.

    Raises:
        InputError: the generator was not made by `numpy.random.default_rng`.
    """
    state = dict(rng.bit_generator.state)
    if state["bit_generator"] != "PCG64":
        raise InputError(f"only generators of numpy.random.default_rng can be saved, not a {state['bit_generator']}")
    return state


def generator(name: str, state: Mapping[str, Any]) -> np.random.Generator:
    """Make a random generator from `state`, data that `generator_state` returned; `name` is used in messages.

    Raises:
        InputError: `state` is not the state of a generator.
    """
    inner, rng = state["state"], np.random.default_rng(0)
    rng.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {key: integer(f"{name}.{key}", inner[key], low=0, high=STATE) for key in ("state", "inc")},
        "has_uint32": integer(f"{name}.has_uint32", state["has_uint32"], low=0, high=1),
        "uinteger": integer(f"{name}.uinteger", state["uinteger"], low=0, high=WORD),
    }
    return rng


def deployment_state(deployment: Deployment) -> dict[str, Any]:
    """Return a deployment as plain data without its labels, which the problem adds again (`Problem.labelled`)."""
    return {name: getattr(deployment, name) for name in POSE_FIELDS}


def deployment(name: str, state: Mapping[str, Any], problem: Problem, count: int) -> Deployment:
    """Make a deployment from data that `deployment_state` returned.

    Args:
        name: name of the argument, for error messages.
        state: data of the deployment.
        problem: problem with the room on whose surfaces the landmarks hang.
        count: number of landmarks.

    Raises:
        InputError: `state` is not the state of a deployment in the room.
    """
    last = len(problem.scene.footprints.hanging.surfaces()) - 1
    surfaces = array(f"{name}.surfaces", state["surfaces"], np.int64, count, low=0, high=last)
    normals = array(f"{name}.normals", state["normals"], np.float64, count, 3, low=-1.5, high=1.5)
    return Deployment(points(f"{name}.positions", state["positions"], problem, count), normals, surfaces)


def points(name: str, value: Any, problem: Problem, count: int) -> FloatArray:
    """Return `value` if it is an array of points `(count, 3)` within the box around a problem's room and fixed tags,
    metres.

    Raises:
        InputError: `value` is not an array of this shape, or a point is outside the box.
    """
    fixed = np.empty((0, 3)) if problem.fixed is None else problem.fixed.positions
    corners = np.vstack([*problem.scene.room.bounds(), fixed])
    low, high = corners.min(axis=0), corners.max(axis=0)
    return array(name, value, np.float64, count, 3, low=low - NEAR_SURFACE, high=high + NEAR_SURFACE)
