"""How good a deployment is at recorded poses, exactly as they were: those it was optimised on, and those held out."""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from lmd.core.bits import BITS
from lmd.core.checks import FloatArray
from lmd.geometry.frames import angles_of
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.pdf import OrientationPdf
from lmd.sight.evaluator import Evaluator

if TYPE_CHECKING:
    from lmd.scene.recorded_poses import RecordedPoses, Records


def held_out_metrics(problem: Problem, deployment: Deployment, recorded: "RecordedPoses") -> dict[str, float]:
    """Shares of recorded time, fractions in [0, 1], the same for any number of threads.

    `recorded_share` is of the time that was optimised on, `held_out_share` of that held out, if any: the time in which
    the view is what the objective asks for, at least n landmarks covered or the camera localised. The standard error
    takes blocks of time as independent, not records; two blocks are needed for it.

    Args:
        recorded: the poses.
    """
    metrics: dict[str, float] = {}
    for name, records in (("recorded", recorded.seen), ("held_out", recorded.kept_back)):
        if not len(records):
            continue
        share, error = _share_and_error(exact_values(problem, deployment, records), records)
        metrics |= {f"{name}_share": share, f"{name}_seconds": float(records.seconds.sum())}
        if error is not None:
            metrics[f"{name}_share_standard_error"] = error
    return metrics


def describe_held_out(figures: Mapping[str, float]) -> dict[str, str]:
    """The figures of `held_out_metrics` as labelled sentences."""
    names = {"held_out": "held out", "recorded": "optimised on"}
    rows = {}
    for name, label in names.items():
        if f"{name}_share" in figures:
            error = figures.get(f"{name}_share_standard_error")
            within = "" if error is None else f" +- {error:.2%}"
            seconds = figures[f"{name}_seconds"]
            rows[label] = f"{figures[f'{name}_share']:.2%}{within} of {seconds:g} recorded seconds have such a view"
    return rows


def exact_values(problem: Problem, deployment: Deployment, records: "Records") -> FloatArray:
    """The objective's value at each of R records, each with its own orientation alone, `(R,)`: 0 or 1, or a weighting.

    They are evaluated in groups of a word of axes, in each of which a position looks along one axis for certain.
    """
    parts = []
    for start in range(0, len(records), BITS):
        poses = records[start : start + BITS].poses
        yaw, pitch, roll = angles_of(np.swapaxes(poses[:, :3, :3], 1, 2))
        alike = np.full(len(poses), 1.0 / len(poses))
        pdf = OrientationPdf(yaw, pitch, alike, roll=roll, by_position=lambda positions: np.eye(len(positions)))
        scene = replace(problem.scene.sized(deployment.edges), pdf=pdf)
        evaluator = Evaluator(scene, poses[:, :3, 3], problem.evaluator.threads)
        landmarks = deployment.positions[None], deployment.normals[None]
        parts.append(problem.objective.values(evaluator, *landmarks)[0])
    return np.concatenate(parts)


def _share_and_error(values: FloatArray, records: "Records") -> tuple[float, float | None]:
    """The mean over time, and its standard error from the residuals of the blocks; None for a single block."""
    seconds, good = records.seconds, records.seconds * values
    share = good.sum() / seconds.sum()
    _, block = np.unique(records.block, return_inverse=True)
    count = int(block.max()) + 1
    if count < 2:
        return float(share), None
    residual = np.bincount(block, weights=good - share * seconds)
    return float(share), float(np.sqrt(count / (count - 1) * (residual**2).sum()) / seconds.sum())
