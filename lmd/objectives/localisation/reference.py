"""Localisation formula by formula: the oracle that every faster path must agree with. Only tests import this.

Shapes: A orientations, K landmarks, P positions.
"""

from typing import Any

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.geometry.squares import upright
from lmd.objectives.localisation.information import PosePrecision, Precision, meets, moments, share_of
from lmd.objectives.localisation.objective import Localisation
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.models.paper import dot
from lmd.sight.reference import cap_count, coverage_caps, n_ple_cap


def view_information(
    scene: Scene, deployment: Deployment, asked: Precision | PosePrecision, position: FloatArray, axes: FloatArray
) -> FloatArray:
    """A, g and C of each view, `(15, A)`, of the landmarks that it covers."""
    caps = coverage_caps(scene, deployment, position, axes)
    offset = deployment.positions - position
    right, up = upright(deployment.normals)
    sides = (asked.half * right, asked.half * up)
    with np.errstate(all="ignore"):  # of a landmark that is not covered the depth may be anything
        depth = dot(axes[:, None, :3], offset)
        formulas: Any = moments.py_func
        moment = formulas(*offset.T, *sides[0].T, *sides[1].T, asked.share)
        weight = 1.0 / (depth * depth * depth)
        return np.stack([np.where(caps, share_of.py_func(each, weight), 0.0).sum(axis=1) for each in moment])


def localised(
    scene: Scene, deployment: Deployment, objective: Localisation, position: FloatArray, axes: FloatArray
) -> BoolArray:
    """Which views are localised, `(A,)`."""
    asked = objective.precision(scene)
    enough = n_ple_cap(cap_count(coverage_caps(scene, deployment, position, axes)), objective.n)
    if not asked.asks:
        return enough
    with np.errstate(all="ignore"):
        return np.asarray(enough & meets(asked, *view_information(scene, deployment, asked, position, axes)))
