"""Standard deviations of the camera pose estimated from one image, at random poses.

Rotation errors are small angles about the axes of a level body that has the heading (yaw) of the camera. Roll is about
the forward axis, pitch about the left axis, yaw about the vertical. These angles are also defined for a camera that
looks straight up.

There are three kinds of views, named by the number of camera poses that fit the image: `one`, `two`, or `none` if the
view shows no tag. The kind is `two` if the view shows a single tag, and the second, mirrored solution of PnP fits
better than the true pose with a probability above 1 % (`lmd.objectives.localisation.ambiguity`). The standard
deviations then refer to the true pose.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated

import numpy as np

from lmd.adjust.gauge import in_world
from lmd.core.checks import Checked, Count, FloatArray, InputError, NotNegative, choice
from lmd.core.memory import check_memory
from lmd.detection.corner_errors import CORNER_ERRORS, CornerErrors, MeasuredCorners
from lmd.detection.frames import draw_poses
from lmd.estimation.pose_covariance import WEIGHTS, TagErrors, pose_covariances
from lmd.evaluation.accuracy import as_localisation
from lmd.evaluation.rendered_corners import measured_corners
from lmd.geometry.frames import angles_of
from lmd.geometry.se3 import axis_and_right, cross
from lmd.objectives.localisation.ambiguity import CONFIDENCE
from lmd.objectives.localisation.reference import mirrored_probabilities
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.sight.views import visible_to_each

if TYPE_CHECKING:
    import pandas as pd

SDS = tuple(f"sd_{name}" for name in ("x", "y", "z", "roll", "pitch", "yaw"))
ONE, TWO, NONE = "one", "two", "none"  # kinds of poses
VIEW_BYTES = 2000  # memory of a view, bytes
AUTO, OBJECTIVE, RENDERED = "auto", "objective", "rendered"
CORNERS = (AUTO, OBJECTIVE, RENDERED, *CORNER_ERRORS)
ALSO = {"wpilib": "apriltag_decimate2"}  # detectors of the visibility model with the corner errors of another one


@dataclass(frozen=True)
class UncertaintyStudy(Checked):
    """Settings of a study of the pose's uncertainty.

    Raises:
        InputError: a value is out of range.
    """

    corners: Annotated[str, partial(choice, options=CORNERS)] = AUTO
    """Source of the corner noise. The name of a detector in `CORNER_ERRORS` stands for its table of noise by pitch,
    measured with another camera; `objective` stands for the objective's constant `pixel_noise`. `rendered` measures the
    errors of the visibility model's detector in rendered images of the deployment. `auto` is `rendered` if that is
    possible, otherwise the table of that detector, or `objective` if the detector's corner errors are unknown.
    """
    shift: NotNegative | None = None
    """Standard deviation, pixels, of a shift of the tags' edges, outwards or inwards, that is common to all tags in an
    image; None for the detector's `CornerErrors.inward_spread`, which is 0 for `objective`.
    """
    weights: Annotated[str, partial(choice, options=WEIGHTS)] = "equal"
    """Weights of the corners in the pose solver, see `lmd.estimation.pose_covariance`."""
    views: Count = 20000
    """Number of random views."""
    frames: Count = 200
    """Number of images rendered to measure the corner noise."""

    def _validate(self) -> None:
        check_memory(VIEW_BYTES * self.views, f"views = {self.views}", "views")

    def _reader(self, problem: Problem) -> str:
        """Name of the detector whose corner errors are used; `objective` if the objective's `pixel_noise` is used
        instead.
        """
        if self.corners not in (AUTO, RENDERED):
            return self.corners
        name = ALSO.get(name := str(getattr(problem.scene.visibility, "detector", OBJECTIVE)), name)
        return name if name in CORNER_ERRORS else OBJECTIVE

    def errors(self, problem: Problem, deployment: Deployment, seed: int) -> tuple[TagErrors, str]:
        """Errors of the tag corners, for tags without errors in the map; and a text about the source of the errors.

        Raises:
            InputError: corners must be measured in rendered images, but the detector is unknown or finds too few tags.
        """
        reader = self._reader(problem)
        noise, about = self._noise(problem, deployment, reader, seed)
        spread = 0.0 if reader == OBJECTIVE else CORNER_ERRORS[reader].inward_spread
        exact = np.zeros((len(deployment), 6, 6))
        return TagErrors(noise, spread if self.shift is None else self.shift, exact, self.weights), about

    def _noise(
        self, problem: Problem, deployment: Deployment, reader: str, seed: int
    ) -> tuple[CornerErrors | MeasuredCorners | float, str]:
        """Noise of the tag corners, and a text about its source.

        The noise is a table of a detector, measurements in rendered images, or one number, pixels.
        """
        why = ""
        if self.corners == RENDERED or (self.corners == AUTO and reader != OBJECTIVE):
            try:
                measured = measured_corners(problem, deployment, reader, self.frames, seed)
            except InputError as error:
                if self.corners == RENDERED:
                    raise
                why = f", measured with another camera, as images could not be rendered: {error}".removesuffix(".")
            else:
                return measured, f"of {reader} in {self.frames} rendered images"
        if reader == OBJECTIVE:
            return as_localisation(problem.objective).pixel_noise, "of the objective"
        return CORNER_ERRORS[reader], f"of the table of {reader}{why}"


@dataclass(frozen=True)
class Uncertainty:
    """Standard deviations of the camera pose as estimated in each of V views of K tags."""

    views: "pd.DataFrame"
    """Table with a row for each view. The columns are `x,y,z` (m), `yaw,pitch,roll` (rad), `tags` (their number),
    `distance` (mean distance of the tags, m), and the kind `pose` (`one`, `two`, `none`). `SDS` are the standard
    deviations (m, rad; NaN if there is no pose). `mirrored` is the probability that the mirrored pose of a single tag
    fits better (NaN for another number of tags).
    """
    poses: FloatArray
    """Camera pose of each view, camera to world, `(V, 4, 4)`."""
    covariances: FloatArray
    """Covariance of position and rotation (p, r) in the world frame, m^2 and rad^2, `(V, 6, 6)`; infinite if there is
    no pose.
    """
    corners: str
    """Text about the source of the corner errors."""

    def metrics(self) -> dict[str, float]:
        """Metrics: the fraction of views of each kind; and the median and the 90 % quantile, over the views of kind
        `one`, of each standard deviation.
        """
        found = {f"share_{kind}": float((self.views.pose == kind).mean()) for kind in (ONE, TWO, NONE)}
        some = self.views[self.views.pose == ONE]
        if len(some):
            for name, level in (("median", 0.5), ("90", 0.9)):
                found |= {f"{column}_{name}": float(some[column].quantile(level)) for column in SDS}
        return found


def uncertainty(
    problem: Problem,
    deployment: Deployment,
    study: UncertaintyStudy,
    seed: int,
    places: FloatArray | None = None,
    joint: FloatArray | None = None,
) -> Uncertainty:
    """Compute the standard deviations of the camera pose in random views.

    Args:
        problem: problem with the scene; the visibility model decides which tags a view shows.
        deployment: K tags.
        study: settings.
        seed: seed of the views.
        places: covariance of the error of each tag's pose in the map, `(K, 6, 6)`, m^2 and rad^2; None for exact poses.
        joint: joint covariance of all tags' poses, added to `places`, `(6 K, 6 K)`; None to add nothing.

    Raises:
        InputError: landmarks are points, or `UncertaintyStudy.errors` raises it.
    """
    import pandas as pd

    problem.scene.tag.check_edge()
    poses = draw_poses(problem.scene, study.views, seed)
    errors, about = study.errors(problem, deployment, seed)
    errors = replace(errors, joint=joint, places=errors.places if places is None else places)
    scene, body = problem.scene, (problem.scene.cameras, problem.scene.extrinsics)
    seen = visible_to_each(problem.evaluator, deployment, poses[:, :3, 3], axis_and_right(poses))
    found, sigmas, _ = pose_covariances(*body, poses, deployment, scene.tag, seen, errors)
    covariances, shown = in_world(poses, found), seen.any(axis=0)
    counts, (frame, tag) = shown.sum(axis=1), np.nonzero(shown)
    away = np.linalg.norm(deployment.places[tag] - poses[frame, :3, 3], axis=1)
    ups, half = deployment.ups, deployment.edges_of(scene.tag)[:, None] / 2.0
    sides = half * np.stack([cross(ups, deployment.normals), ups])
    alone = counts[frame] == 1
    mirrored, frames, only = np.full(len(poses), np.nan), frame[alone], tag[alone]
    views = poses[frames], deployment.places[only], sides[:, only], seen[:, frames, only], sigmas[frames, only]
    mirrored[frames] = mirrored_probabilities(scene, *views)
    yaw, pitch, roll = angles_of(np.swapaxes(poses[:, :3, :3], 1, 2))
    with np.errstate(invalid="ignore"):  # no tags
        distance = np.bincount(frame, away, len(poses)) / counts
    rows = {
        **dict(zip("xyz", poses[:, :3, 3].T, strict=True)),
        **{"yaw": yaw, "pitch": pitch, "roll": roll.round(12) + 0.0, "tags": counts, "distance": distance},
        **dict(zip(SDS, level_deviations(covariances, yaw).T, strict=True)),
        "pose": np.where(counts == 0, NONE, np.where(mirrored > 1.0 - CONFIDENCE, TWO, ONE)),
        "mirrored": mirrored,
    }
    return Uncertainty(pd.DataFrame(rows), poses, covariances, about)


def level_deviations(covariances: FloatArray, yaw: FloatArray) -> FloatArray:
    """Standard deviations `SDS` (x, y, z, roll, pitch, yaw) of the pose in V views, `(V, 6)`; NaN without a pose.

    Args:
        covariances: covariances of position and rotation, world frame, m^2 and rad^2, `(V, 6, 6)`; infinite if there is
            no pose.
        yaw: heading of the level body, clockwise from the y axis, rad, `(V,)`.
    """
    sine, cosine, zero = np.sin(yaw), np.cos(yaw), np.zeros_like(yaw)
    forward, left, up = (sine, cosine, zero), (-cosine, sine, zero), (zero, zero, zero + 1.0)
    axes = np.moveaxis(np.array([forward, left, up]), -1, 0)
    known, squares = np.isfinite(covariances).all(axis=(1, 2)), np.full((len(yaw), 6), np.nan)
    squares[known, :3] = np.diagonal(covariances[known][:, :3, :3], axis1=1, axis2=2)
    squares[known, 3:] = np.einsum("vij,vjk,vik->vi", axes[known], covariances[known][:, 3:, 3:], axes[known])
    return np.asarray(np.sqrt(squares))
