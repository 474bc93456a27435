"""Filtered pose as an objective: the fraction of the time of drives in which a Kalman filter knows the pose to a
tolerance.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np

from lmd.core.checks import BoolArray, Count, FloatArray, InputError, Positive, Share, real
from lmd.incremental.field import Field
from lmd.objectives.base import AtLeast, Headline, figure_of, with_error
from lmd.objectives.coverage import Mean
from lmd.objectives.crowd import WorstGroups
from lmd.objectives.filtered.drives import Drives
from lmd.objectives.filtered.evaluation import (
    FilteredPoses,
    filtered_poses,
    frame_information,
    reference_filter,
    reference_information,
)
from lmd.objectives.filtered.field import filtered_field
from lmd.objectives.filtered.lanes import Tolerance
from lmd.objectives.localisation.information import QUANTUM, Precision, deviation_per_variance, precision
from lmd.objectives.reference_field import ReferenceField
from lmd.objectives.sampling import Sampling
from lmd.scene.criteria import TOLERANCE
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.blocks import SINGLE_ERROR
from lmd.sight.evaluator import Evaluator
from lmd.sight.views import visible
from lmd.space.crowd import worst_mean, worst_of


class SeenFrames:
    """Weighted sum of log(1 + number of tags in view) over the frames; a `Selection`.

    A further tag gains more in a frame with fewer tags, so chosen tags spread over the drives. The sum is submodular if
    no tag hides another.

    Args:
        evaluator: scene with the frames as positions.
        drives: the drives.
        relevance: weights of the frames, `(F,)`.
    """

    label = "log of the tags in view along the drives"

    def __init__(self, evaluator: Evaluator, drives: Drives, relevance: FloatArray) -> None:
        self._evaluator, self._drives, self._relevance = evaluator, drives, relevance
        self._seen = np.zeros(len(relevance))

    def gains(self, poses: Deployment) -> FloatArray:
        """See `Selection.gains`."""
        prices = self._relevance * np.log1p(1.0 / (1.0 + self._seen))
        return np.array([prices[self._views(poses[k : k + 1])].sum() for k in range(len(poses))])

    def add(self, pose: Deployment) -> None:
        """See `Selection.add`."""
        self._seen += self._views(pose)

    def _views(self, pose: Deployment) -> BoolArray:
        """Mask `(F,)` of the frames in which a single tag at `pose` is seen."""
        drives, evaluator = self._drives, self._evaluator
        frames = np.arange(len(self._seen))
        if evaluator.scene.rig is None:  # most frames look elsewhere
            away = pose.positions[0] - drives.positions
            ahead = (away * drives.axes[:, :3]).sum(axis=1)
            cosine = float(evaluator.sight.outer_cosine) - SINGLE_ERROR
            frames = np.flatnonzero(ahead >= cosine * np.linalg.norm(away, axis=1))
        seen = np.zeros(len(self._seen), dtype=np.bool_)
        seen[frames] = visible(evaluator, pose, drives.positions[frames], drives.axes[frames])[:, 0]
        return seen


# In quanta of information: rounding matters if VAGUE quanta exceed the information of the vaguest pose; pivots below
# ROUNDED are rounding errors.
VAGUE, ROUNDED = 512, 64
WORST = 0.05  # share of the drives in the figure of the worst drives, unless `Filtered.worst` is given


@dataclass(frozen=True)
class Filtered(AtLeast):
    """Fraction of the time of all drives, or of the worst drives, in which the filtered pose is known to a tolerance.

    Each frame of a drive is a position of the problem (`lmd.space.changed.DrivenRoom`). The value of a frame is 1 if
    the standard deviations of the filtered pose are at most the tolerances, otherwise 0. The filter uses the odometry,
    and the tags in view in this frame and in the earlier frames (`lanes`).

    Args:
        n: least number of tags in view; the filter ignores an image with fewer tags.
        thold_p: least value of a qualified position; values are 0 or 1.
        drives: training drives, which determine the fitness.
        fresh: validation drives, or None.
        tolerance: greatest standard deviation of the filtered position, metres.
        rotation_tolerance: greatest standard deviation of the filtered rotation, rad; None for no limit.
        pixel_noise: standard deviation of each coordinate of a corner, pixels.
        worst: fraction of the drives that count as the worst: those with the smallest fraction of time with a known
            pose. The fitness is the mean over these drives. None to use the total time of all drives.

    Raises:
        InputError: a value is out of range.
    """

    n: Count = 1
    thold_p: Share = 1.0
    drives: Drives = None  # type: ignore[assignment] # required, though the fields of the base have defaults
    fresh: Drives | None = None
    tolerance: Positive = 0.02
    rotation_tolerance: Positive | None = None
    pixel_noise: Annotated[float, partial(real, low=1e-6)] = 0.5
    worst: Annotated[float, partial(real, above=0.0, high=1.0)] | None = None

    def _validate(self) -> None:
        if not isinstance(self.drives, Drives):
            raise InputError(f"drives must be a Drives object, got {self.drives!r}.", "drives")

    @property
    def sampling(self) -> Sampling | None:
        """See `Objective.sampling`. The result is None, because the frames of the drives are the sample."""
        return None

    @property
    def headline(self) -> Headline:
        """See `Objective.headline`."""
        return figure_of("filtered_share" if self.worst is None else "worst_drives")

    @property
    def name(self) -> str:
        """See `Objective.name`."""
        return f"filtered n={self.n} {1e3 * self.tolerance:g} mm"

    @property
    def value_label(self) -> str:
        """See `Objective.value_label`."""
        return f"filtered position known to {1e3 * self.tolerance:g} mm"

    def asked(self, scene: Scene) -> Precision:
        """Edge lengths of the tags, and weight of each corner in the information.

        The limits in the returned `Precision` are not used by the filter.
        """
        camera, limits = scene.cameras[0], (self.tolerance, self.rotation_tolerance)
        return precision(camera, scene.tag, self.pixel_noise, *limits, scene.edges)

    def limits(self, scene: Scene) -> Tolerance:
        """Settings of the filter: limits up to which a pose counts as known, scale and least value of the information.

        The scale converts the stored information of an image to 1 / m^2 and 1 / rad^2. Information below the least
        value counts as a rounding error; the least value is None if rounding does not matter.
        """
        turn = math.inf if self.rotation_tolerance is None else self.rotation_tolerance
        scale = deviation_per_variance(scene.cameras[0], self.pixel_noise)
        # A view of few points has an information of up to about 100 quanta in directions that it leaves undetermined.
        vague = VAGUE * QUANTUM / scale**2 * max(drives.vaguest for drives in (self.drives, self.fresh) if drives) > 1.0
        limits = self.tolerance**2 * (1.0 + TOLERANCE), turn**2 * (1.0 + TOLERANCE)
        return Tolerance(*limits, 1.0 / scale**2, ROUNDED * QUANTUM if vague else None)

    def poses(self, evaluator: Evaluator, deployment: Deployment, drives: Drives | None = None) -> FilteredPoses:
        """Covariance of the filtered pose in each frame of `drives`, by default of the training drives."""
        scene, along = evaluator.scene, drives or self.drives
        asked, limits = self.asked(scene), self.limits(scene)
        if evaluator.by_reference:
            return reference_filter(along, reference_information(scene, deployment, asked, self.n, along), limits)
        return filtered_poses(along, frame_information(evaluator, deployment, asked, self.n, along), limits)

    def values(self, evaluator: Evaluator, positions: FloatArray, normals: FloatArray) -> FloatArray:
        """See `Objective.values`.

        Raises:
            InputError: the positions of the evaluator are not the frames of the drives.
        """
        self._check(evaluator)
        evaluator.scene.check_count(positions.shape[1])
        each = (self.poses(evaluator, Deployment(*landmarks)) for landmarks in zip(positions, normals, strict=True))
        return np.stack([poses.known.astype(np.float64) for poses in each])

    def _check(self, evaluator: Evaluator) -> None:
        if not np.array_equal(evaluator.positions, self.drives.positions):
            raise InputError(
                "the objective has values along its drives only, not at other positions of the room.", "objective"
            )

    def fitness(self, values: FloatArray, relevance: FloatArray) -> FloatArray:
        """See `Objective.fitness`.

        Raises:
            InputError: the fitness uses the worst drives, and the total relevance of a drive is zero.
        """
        if self.worst is not None:
            return self._worst_share(self.drives, values, relevance)
        return _mean(values, relevance)

    def _worst_share(self, drives: Drives, values: FloatArray, relevance: FloatArray) -> FloatArray:
        return worst_mean(drives.share_of(values, relevance), self._worst_count(drives))

    def _worst_count(self, drives: Drives) -> int:
        return worst_of(len(drives), self.worst or WORST)

    def shares(self, values: FloatArray) -> Mapping[str, FloatArray | BoolArray]:
        """See `Objective.shares`."""
        return {"filtered_share": values}

    def figures(self, values: FloatArray, relevance: FloatArray) -> dict[str, float]:
        """Two metrics: the fraction of the time in which the pose is known, for all drives and for the worst drives."""
        return self._figures(self.drives, values)

    def _figures(self, drives: Drives, values: FloatArray) -> dict[str, float]:
        return {
            "filtered_share": float(_mean(values, drives.seconds)),
            "worst_drives": float(self._worst_share(drives, values, drives.seconds)),
        }

    def describe(self, figures: Mapping[str, float], positions: int, count: int) -> dict[str, str]:
        """See `Objective.describe`."""
        seconds = self.drives.seconds.sum()
        return {
            "filtered share": f"{figures['filtered_share']:.2%} of {seconds:.0f} s in {len(self.drives)} drives have a "
            f"{self.value_label}, with {count} landmarks",
            "worst drives": f"{figures['worst_drives']:.2%} of the time in {self._worst_of(self.drives)}",
        }

    def off_grid(self, evaluator: Evaluator, deployment: Deployment) -> dict[str, float]:
        """See `lmd.objectives.base.SelfValidating`: metrics on the validation drives."""
        if self.fresh is None:
            return {}
        known = self.poses(evaluator, deployment, self.fresh).known.astype(np.float64)
        figures, shares = self._figures(self.fresh, known), self.fresh.share_of(known, self.fresh.seconds)
        if len(shares) > 1:
            figures["filtered_share_standard_error"] = float(shares.std(ddof=1) / math.sqrt(len(shares)))
        return {f"grid_free_{key}": value for key, value in figures.items()}

    def describe_validation(self, figures: Mapping[str, float]) -> dict[str, str]:
        """See `Objective.describe_validation`."""
        if self.fresh is None:
            return {}
        return {
            "on fresh drives": f"{with_error(figures, 'grid_free_filtered_share')} of {self.fresh.seconds.sum():.0f} s "
            f"in {len(self.fresh)} drives; {figures['grid_free_worst_drives']:.2%} in {self._worst_of(self.fresh)}"
        }

    def _worst_of(self, drives: Drives) -> str:
        return f"the worst {self._worst_count(drives)} of {len(drives)} drives"

    def field(self, evaluator: Evaluator) -> Field:
        """See `Incremental.field`; for a rig, each move costs a full evaluation."""
        self._check(evaluator)
        scene = evaluator.scene
        if scene.rig is not None or evaluator.by_reference:
            return ReferenceField(self, evaluator)
        return filtered_field(evaluator, self.drives, self.asked(scene), self.n, self.limits(scene))

    def selection(self, evaluator: Evaluator, relevance: FloatArray) -> SeenFrames:
        """See `Objective.selection`."""
        self._check(evaluator)
        return SeenFrames(evaluator, self.drives, relevance)

    def target(self, relevance: FloatArray) -> Mean | WorstGroups:
        """See `Incremental.target`."""
        if self.worst is None:
            return Mean(relevance)
        number = len(self.drives)
        equal = Mean(self.drives.relative(relevance) / number)
        return WorstGroups(equal, self.drives.of_frame, number, self._worst_count(self.drives))


def _mean(values: FloatArray, relevance: FloatArray) -> FloatArray:
    return np.asarray((values * relevance).sum(axis=-1) / relevance.sum())
