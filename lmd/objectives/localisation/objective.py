"""Localisation as an objective: the probability that one image gives the camera's position to within a tolerance."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any

import numpy as np

from lmd.core.checks import BoolArray, Count, FloatArray, Positive, Share, choice, real
from lmd.objectives.base import AtLeast, Headline, Selection, figure_of, with_error
from lmd.objectives.coverage import Mean, Threshold
from lmd.objectives.localisation.ambiguity import resolved
from lmd.objectives.localisation.evaluation import localised_views
from lmd.objectives.localisation.field import LocalisationField, localisation_field
from lmd.objectives.localisation.information import Precision, deviation_per_variance, precision
from lmd.objectives.localisation.log_det import log_det_selection
from lmd.objectives.localisation.trial import mixed
from lmd.objectives.sampling import Sampling
from lmd.scene.criteria import TOLERANCE
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import PROBABILITY_ONE

FITNESS = ("mean", "qualified")
AMBIGUITY = ("resolved", "ignored")
# Smaller samples than for coverage, as each view costs more; samples are drawn again during a run.
SAMPLING = Sampling(positions=1, divisions=8)
# Prior of greedy selection: standard deviation of the position, in tolerances, and of the rotation, rad.
PRIOR_TOLERANCES, PRIOR_ROTATION = 5.0, 1.0
PRIOR_POSITION = 1.0  # standard deviation of the position if there is no tolerance, metres
WORST = 0.05  # order of the reported quantile of the values over positions


@dataclass(frozen=True)
class Localisation(AtLeast):
    """Probability that one image localises the camera.

    A view is localised if at least n landmarks are covered *and* the standard deviation of the position, computed from
    the landmarks' corners (`information`), is at most the tolerance. The value L(p) of a position is the probability of
    a localised view. Tags have the corners of `scene.tag`; if landmarks are points, at least three are needed for a
    pose.

    Args:
        n: least number of landmarks that the camera must see at the same time.
        thold_p: least value of a qualified position.
        tolerance: greatest standard deviation of the position, metres; infinite for plain coverage.
        pixel_noise: standard deviation of each coordinate of a corner, pixels.
        climbs: fitness that optimisers maximise: `mean`, the mean of the values over positions, or `qualified`, the
            fraction of positions whose value reaches `thold_p`.
        rotation_tolerance: greatest standard deviation of the rotation, rad; None for no limit.
        ambiguity: rule for a view of a single tag (n = 1): `resolved` requires that the tag's two poses can be
            distinguished (`localisation.ambiguity`), `ignored` does not.
        coverage_weight: weight w of P_n in the value, (1 - w) L + w P_n.
        sampling: random positions and orientations on which the fitness is computed; None for the room's grid and the
            orientations of the scene's PDF.

    Raises:
        InputError: a value is out of range.
    """

    n: Count = 2
    thold_p: Share = 0.5
    tolerance: Annotated[float, partial(real, above=0.0, infinite=True)] = 0.02
    pixel_noise: Positive = 0.5
    climbs: str = "mean"
    rotation_tolerance: Positive | None = None
    ambiguity: Annotated[str, partial(choice, options=AMBIGUITY)] = "resolved"
    coverage_weight: Share = 0.0
    sampling: Sampling | None = SAMPLING

    def _validate(self) -> None:
        choice("fitness", self.climbs, FITNESS)

    @property
    def headline(self) -> Headline:
        """See `Objective.headline`."""
        return figure_of("qualified_ratio" if self.climbs == "qualified" else self._share)

    @property
    def _share(self) -> str:
        """Name of the figure (metric) that is the mean of the positions' values."""
        return "weighted_share" if self.coverage_weight else "localised_share"

    @property
    def name(self) -> str:
        """See `Objective.name`."""
        weight = f" w={self.coverage_weight:g}" if self.coverage_weight else ""
        return f"n={self.n} {1e3 * self.tolerance:g} mm{weight}"

    @property
    def value_label(self) -> str:
        """See `Objective.value_label`."""
        label = f"probability of localising to {1e3 * self.tolerance:g} mm"
        return f"{label}, and of seeing {self.n}, weighted" if self.coverage_weight else label

    def precision(self, scene: Scene) -> Precision:
        """Limits that a localised view must satisfy; for a rig, in units of the first camera's
        `deviation_per_variance`.
        """
        camera, noise = scene.cameras[0], self.pixel_noise
        asked = precision(camera, scene.tag, noise, self.tolerance, self.rotation_tolerance, scene.edges)
        if self.n > 1 or self.ambiguity == "ignored" or scene.tag.is_point:
            return asked
        return resolved(asked, deviation_per_variance(camera, noise))

    def values(self, evaluator: Evaluator, positions: FloatArray, normals: FloatArray) -> FloatArray:
        """See `Objective.values`."""
        views = localised_views(evaluator, positions, normals, self.n, self.precision(evaluator.scene))
        return np.asarray(mixed(views.localised, views.covered, self.coverage_weight) / PROBABILITY_ONE)

    def fitness(self, values: FloatArray, relevance: FloatArray) -> FloatArray:
        """See `Objective.fitness`."""
        contribution = values if self.climbs == "mean" else self.qualified(values)
        return np.asarray((contribution * relevance).sum(axis=-1) / relevance.sum())

    def shares(self, values: FloatArray) -> Mapping[str, FloatArray | BoolArray]:
        """See `Objective.shares`."""
        return {self._share: values, "qualified_ratio": self.qualified(values)}

    def figures(self, values: FloatArray, relevance: FloatArray) -> dict[str, float]:
        """Metrics: mean value, fraction of qualified positions, and 5 % quantile of the values."""
        return {
            **{key: float(share.mean()) for key, share in self.shares(values).items()},
            "worst_positions": float(np.quantile(values, WORST)),
        }

    def describe(self, figures: Mapping[str, float], positions: int, count: int) -> dict[str, str]:
        """See `Objective.describe`."""
        return {
            figure_of(self._share).label: f"{figures[self._share]:.2%}, the {self.value_label}, with {count} landmarks",
            "qualified ratio": f"{figures['qualified_ratio']:.2%} of {positions} positions reach {self.thold_p:g}",
            "worst positions": f"{WORST:.0%} of them have {figures['worst_positions']:.2%} or less",
        }

    def describe_validation(self, figures: Mapping[str, float]) -> dict[str, str]:
        """See `Objective.describe_validation`."""
        share = with_error(figures, f"grid_free_{self._share}")
        return {
            "off the grid": f"{figure_of(self._share).label} {share}, "
            f"{with_error(figures, 'grid_free_qualified_ratio')} of random positions qualified",
            "on a finer grid": f"{self.headline.label} {figures[f'finer_grid_{self.headline.key}']:.2%}",
        }

    def field(self, evaluator: Evaluator) -> LocalisationField:
        """See `Objective.field`."""
        return localisation_field(evaluator, self.n, self.precision(evaluator.scene), self.coverage_weight)

    def target(self, relevance: FloatArray) -> Mean | Threshold:
        """See `Objective.target`."""
        if self.climbs == "mean":
            return Mean(relevance)
        return Threshold(math.ceil((self.thold_p - TOLERANCE) * PROBABILITY_ONE), relevance)

    def selection(self, evaluator: Evaluator, relevance: FloatArray) -> Selection:
        """See `Objective.selection`: the log det of the information, with a prior on position and rotation."""
        scene = evaluator.scene
        scale = deviation_per_variance(scene.cameras[0], self.pixel_noise)
        prior = PRIOR_TOLERANCES * self.tolerance if math.isfinite(self.tolerance) else PRIOR_POSITION
        known = (scale / prior) ** 2, (scale / PRIOR_ROTATION) ** 2
        return log_det_selection(evaluator, relevance, replace(self, ambiguity="ignored").precision, known)


def localisation(fitness: str = "mean", **settings: Any) -> Localisation:
    """Make a `Localisation` from a configuration, in which the argument `climbs` is called `fitness`."""
    return Localisation(climbs=fitness, **settings)
