"""Predicted accuracy of the position from one image, for every view of a deployment and any objective.

The prediction is the standard deviation of the camera's position, computed by `lmd.objectives.localisation`. The
prediction is infinite for views that cover fewer than n landmarks, and for views of a single tag if two camera poses
fit the image about equally well. All results are for poses off the grid: positions are random, and orientations are
drawn from the PDF's continuous distribution.
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.core.tables import write_table
from lmd.evaluation.validation import Sample, sampled_evaluators
from lmd.objectives.base import Objective
from lmd.objectives.localisation import Localisation
from lmd.objectives.localisation.evaluation import localised_views
from lmd.objectives.localisation.information import deviation_per_variance
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.sight.evaluator import Evaluator, averaged
from lmd.sight.kernels import PROBABILITY_ONE

if TYPE_CHECKING:
    import pandas as pd

TOLERANCES = (0.01, 0.02, 0.05)  # tolerances of the position error for which shares of views are reported, metres
SAMPLE = Sample(groups=8, positions=512, divisions=23)


def as_localisation(objective: Objective) -> Localisation:
    """Return the objective if it is `Localisation`; otherwise the default `Localisation` with the objective's n."""
    return objective if isinstance(objective, Localisation) else Localisation(objective.n)


def predicted_errors(problem: Problem, deployment: Deployment, evaluator: Evaluator) -> tuple[FloatArray, FloatArray]:
    """Predict the standard deviation of the camera's position in each view, metres, `(P, D)` for P positions and D
    orientations; return these standard deviations, and P_n at each position, `(P,)`.

    The noise of a corner and the rule for single tags come from the objective, or from the default `Localisation`.
    """
    objective, scene = problem.objective, problem.scene
    of_any = replace(as_localisation(objective), tolerance=np.inf, rotation_tolerance=None)
    landmarks = deployment.positions[None], deployment.normals[None]
    views = localised_views(evaluator, *landmarks, of_any.n, of_any.precision(evaluator.scene), keep=True)
    scale = deviation_per_variance(scene.cameras[0], of_any.pixel_noise)
    errors = scale * np.sqrt(views.variances[0, :, : len(evaluator.scene.orientations.axes)])
    return errors, views.covered[0] / PROBABILITY_ONE


def _share_name(tolerance: float) -> str:
    return f"localised_share_{1e3 * tolerance:g}mm"


def accuracy_metrics(problem: Problem, deployment: Deployment, seed: int, sample: Sample = SAMPLE) -> dict[str, float]:
    """Metrics of accuracy: the mean of P_n; for each of `TOLERANCES`, the fraction of the views whose predicted error
    is within it; and the median and the 90 % quantile of the predicted error over the views, metres.

    Views without a finite error count as infinite; infinite quantiles are left out.

    Args:
        problem: problem with the scene, n, and the noise of a corner.
        deployment: K landmarks.
        seed: seed of the random poses.
        sample: number of random poses.
    """
    parts = []
    scene = problem.scene.sized(deployment.edges)
    for evaluator in sampled_evaluators(scene, len(deployment), seed, sample, problem.evaluator.threads):
        errors, covered = predicted_errors(problem, deployment, evaluator)
        parts.append((errors, np.broadcast_to(evaluator.scene.probability(evaluator.positions), errors.shape), covered))
    errors, weights, covered = (np.concatenate([part[i].reshape(-1) for part in parts]) for i in range(3))
    weights = weights / weights.sum()
    metrics = {"covered_share": float(covered.mean())}
    metrics |= {_share_name(limit): float(weights[errors <= limit].sum()) for limit in TOLERANCES}
    order: IntArray = np.argsort(errors)
    below = np.cumsum(weights[order])
    for name, level in (("median", 0.5), ("90", 0.9)):
        error = errors[order[min(int(np.searchsorted(below, level)), len(order) - 1)]]
        if np.isfinite(error):
            metrics[f"predicted_error_{name}"] = float(error)
    return metrics


def save_accuracy_map(path: str | Path, problem: Problem, deployment: Deployment) -> None:
    """Write a CSV with a row for each grid position. Its columns are `x,y,z`, the fraction of localised views for each
    of `TOLERANCES`, and the median predicted error, metres.

    An infinite median is an empty cell.
    """
    evaluator = problem.evaluator
    errors, _ = predicted_errors(problem, deployment, evaluator)
    weight, errors = evaluator.by_place(problem.scene.probability(evaluator.positions), errors)
    median = _medians(errors, weight)
    columns = dict(zip("xyz", problem.places.T, strict=True))
    columns |= {_share_name(limit): averaged(errors <= limit, weight) for limit in TOLERANCES}
    columns["predicted_error_median"] = np.where(np.isfinite(median), median, np.nan)
    write_table(path, columns)


def plan_of_errors(problem: Problem, deployment: Deployment) -> "pd.DataFrame":
    """Table with the columns `x,y,predicted_error_median`, metres; the median is taken over all heights and
    orientations at the place (x, y).

    The median is infinite where fewer than half of the views cover n landmarks.
    """
    import pandas as pd

    evaluator = problem.evaluator
    errors, _ = predicted_errors(problem, deployment, evaluator)
    places, place = np.unique(evaluator.positions[:, :2].round(9), axis=0, return_inverse=True)
    weight = np.broadcast_to(problem.scene.probability(evaluator.positions), errors.shape)
    columns = [(errors[place == i], weight[place == i]) for i in range(len(places))]
    medians = [_medians(*(part.reshape(1, -1) for part in (e, w / len(e))))[0] for e, w in columns]
    return pd.DataFrame({"x": places[:, 0], "y": places[:, 1], "predicted_error_median": medians})


def _medians(errors: FloatArray, weight: FloatArray) -> FloatArray:
    """Weighted median of each row of `errors` `(P, V)`; the result has the shape `(P,)`. The weights, `(1, V)` or `(P,
    V)`, have the sum 1 in each row.
    """
    order = np.argsort(errors, axis=1)
    ordered = np.take_along_axis(np.broadcast_to(weight, errors.shape), order, axis=1)
    middle = (np.cumsum(ordered, axis=1) >= 0.5).argmax(axis=1)[:, None]
    return np.asarray(np.take_along_axis(errors, np.take_along_axis(order, middle, axis=1), axis=1)[:, 0])
