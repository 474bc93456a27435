"""Predicted accuracy of the position that is estimated from one image; available for every objective.

The prediction is the standard deviation of the camera's position, computed by `lmd.objectives.localisation`. The
prediction is infinite for views that cover fewer than n landmarks, and for views of a single tag if two camera poses
fit the image about equally well. The metrics are for poses off the grid: positions are random, and orientations are
drawn from the PDF's continuous distribution. Maps and plans show the positions of the grid.
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.tables import write_table
from lmd.evaluation.validation import Sample, recorded_evaluators, sampled_evaluators
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
    """Predict the standard deviation of the camera's position in each view, metres, and the probability P_n.

    The noise of a corner, and the rule that decides whether a single tag localises the camera, come from the objective,
    or from the default `Localisation`.

    Returns:
        standard deviations, `(P, D)`, for P positions and D orientations; and the probability P_n at each position that
        a view covers n landmarks, `(P,)`.
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
    """Metrics of accuracy: shares of views that cover n landmarks or are accurate, and quantiles of the error.

    The first share is the mean over the positions of P_n, the probability that a view covers n landmarks. For each of
    `TOLERANCES` there is the share of views whose predicted error is at most this tolerance. The quantiles are the
    median and the 90 % quantile over the views, metres; infinite quantiles are left out. The predicted error is
    infinite for views that cover fewer than n landmarks, and for ambiguous views of a single tag.

    For a recording the views are its poses, weighted by their durations, and `longest_uncovered_seconds` is the longest
    time without a view of n landmarks.

    Args:
        problem: problem with the scene, n, and the noise of a corner.
        deployment: K landmarks.
        seed: seed of the random poses.
        sample: number of random poses.
    """
    scene, parts, lasting, longest = problem.scene.sized(deployment.edges), [], None, dict[str, float]()
    if (along := errors_along(problem, deployment)) is not None:
        errors, covered, lasting = (along[name].to_numpy() for name in ("predicted_error", "covered", "seconds"))
        spans = np.flatnonzero(np.diff(covered < 0.5, prepend=False, append=False)).reshape(-1, 2)
        clock = np.append(along.time, along.time.iloc[-1] + lasting[-1])
        weights, longest = lasting, {"longest_uncovered_seconds": float(np.diff(clock[spans]).max(initial=0.0))}
    else:
        for evaluator in sampled_evaluators(scene, len(deployment), seed, sample, problem.evaluator.threads):
            errors, covered = predicted_errors(problem, deployment, evaluator)
            weights = np.broadcast_to(evaluator.scene.probability(evaluator.positions), errors.shape)
            parts.append((errors, weights, covered))
        errors, weights, covered = (np.concatenate([part[i].reshape(-1) for part in parts]) for i in range(3))
    weights = weights / weights.sum()
    metrics = {"covered_share": float(np.average(covered, weights=lasting)), **longest}
    metrics |= {_share_name(limit): float(weights[errors <= limit].sum()) for limit in TOLERANCES}
    for name, level in (("median", 0.5), ("90", 0.9)):
        error = _quantiles(errors[None], weights[None], level)[0]
        if np.isfinite(error):
            metrics[f"predicted_error_{name}"] = float(error)
    return metrics


def save_accuracy_map(path: str | Path, problem: Problem, deployment: Deployment) -> None:
    """Write a CSV with a row for each grid position.

    The columns are `x,y,z`, the fraction of views with a predicted error of at most each of `TOLERANCES`, and the
    median predicted error, metres. An infinite median is an empty cell.
    """
    evaluator = problem.evaluator
    errors, _ = predicted_errors(problem, deployment, evaluator)
    weight, errors = evaluator.by_place(problem.scene.probability(evaluator.positions), errors)
    median = _quantiles(errors, weight)
    columns = dict(zip("xyz", problem.places.T, strict=True))
    columns |= {_share_name(limit): averaged(errors <= limit, weight) for limit in TOLERANCES}
    columns["predicted_error_median"] = np.where(np.isfinite(median), median, np.nan)
    write_table(path, columns)


def errors_along(problem: Problem, deployment: Deployment) -> "pd.DataFrame | None":
    """Table with a row for each recorded pose. The columns are `time`, `seconds` until the next pose, place `x`, `y`
    (m), `covered` (1 if the view covers n landmarks, otherwise 0) and `predicted_error` (m, may be infinite). None for
    a problem without a recording, or with a crowd.
    """
    import pandas as pd

    recorded, parts = problem.scene.recorded, []
    if recorded is None or problem.scene.crowd is not None:
        return None
    for evaluator in recorded_evaluators(problem, deployment, recorded.records):
        errors, covered = predicted_errors(problem, deployment, evaluator)
        parts.append([*evaluator.positions.T[:2], covered, errors[np.arange(len(errors)), evaluator.axis_of]])
    columns = dict(zip(("x", "y", "covered", "predicted_error"), np.concatenate(parts, axis=1), strict=True))
    return pd.DataFrame({"time": recorded.trajectory.time[:-1], "seconds": recorded.records.seconds, **columns})


def plan_of_errors(problem: Problem, deployment: Deployment) -> "pd.DataFrame":
    """Table with the columns `x,y,predicted_error_median`, metres; the median is taken over all heights and
    orientations at the place (x, y). For a recording, the table is that of `errors_along`.

    The median is infinite where fewer than half of the views cover n landmarks.
    """
    import pandas as pd

    if (along := errors_along(problem, deployment)) is not None:
        return along
    evaluator = problem.evaluator
    errors, _ = predicted_errors(problem, deployment, evaluator)
    places, place = np.unique(evaluator.positions[:, :2].round(9), axis=0, return_inverse=True)
    weight = np.broadcast_to(problem.scene.probability(evaluator.positions), errors.shape)
    columns = [(errors[place == i], weight[place == i]) for i in range(len(places))]
    medians = [_quantiles(*(part.reshape(1, -1) for part in (e, w / len(e))))[0] for e, w in columns]
    return pd.DataFrame({"x": places[:, 0], "y": places[:, 1], "predicted_error_median": medians})


def _quantiles(errors: FloatArray, weight: FloatArray, level: float = 0.5) -> FloatArray:
    """Weighted quantile, at the probability `level`, of each row of `errors` `(P, V)`; the result has the shape `(P,)`.
    The weights, `(1, V)` or `(P, V)`, have the sum 1 in each row.
    """
    weights = np.broadcast_to(weight, errors.shape)
    return np.asarray(np.quantile(errors, level, axis=1, weights=weights, method="inverted_cdf"))
