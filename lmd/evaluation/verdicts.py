"""Verdicts of a visibility model on its criteria one by one, and metrics of the criteria.

Verdicts tell which landmarks meet each criterion in a given camera pose.

A landmark is covered if it meets every criterion at the same time. Two metrics describe a criterion, over random poses:
the share of landmarks that meet it, and the share of landmarks that would be covered if this criterion were dropped.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import axis_and_right, camera_pose
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.obstacles import half_edge, required_points, unobstructed

# Separates the random numbers of the poses from other uses of the seed.
CAUSES_STREAM = 0x7768790A
POSITIONS, VIEWS = 256, 16  # number of random positions, and of random orientations at each position


def verdicts(
    scene: Scene,
    deployment: Deployment,
    poses: FloatArray,
    camera: Camera | None = None,
    states: IntArray | None = None,
) -> dict[str, BoolArray]:
    """For each criterion of the scene's visibility model, a mask of the landmarks that meet it in N poses, `(N, K)`.

    The masks are keyed by the name of the criterion. The result is empty if the model has no method `verdicts`.

    Args:
        scene: the scene.
        deployment: K landmarks.
        poses: camera poses, camera to world, `(N, 4, 4)`.
        camera: one camera of the scene's rig; None if the scene has a single camera.
        states: index of the crowd state in each pose, `(N,)`, for the criterion of the crowd.

    Raises:
        InputError: the scene has a rig, and no camera is given.
    """
    camera = camera or scene.single_camera("the verdicts on single poses")
    if not hasattr(scene.visibility, "verdicts"):
        return {}
    axes, scene = axis_and_right(poses), scene.sized(deployment.edges)
    every = [scene] * len(poses) if states is None else list(map(scene.in_state, states.tolist()))
    views = zip(every, poses, axes[:, None], strict=True)
    rows = [_verdicts_of(own, camera, deployment, pose[:3, 3], axis) for own, pose, axis in views]
    return {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}


def _verdicts_of(
    scene: Scene, camera: Camera, deployment: Deployment, position: FloatArray, axes: FloatArray
) -> dict[str, BoolArray]:
    """For each criterion, keyed by name, the mask of the landmarks that meet it, `(A, K)`, for A camera orientations.

    The camera is at `position`. `axes` `(A, 6)` has the optical axis and the direction to the right in the image, unit
    vectors in the world frame. The criteria are those of the model, of the room if it has obstacles, and of the crowd
    if the scene has a single crowd state.
    """
    landmarks = deployment.positions, deployment.normals
    found = dict(scene.visibility.verdicts(camera, position, axes, *landmarks))  # type: ignore[attr-defined]
    if scene.room.blockers() is not None:
        clear = unobstructed(scene.room, scene.visibility.sight(camera), position, *landmarks)
        found["obstacles"] = np.broadcast_to(clear, (len(axes), len(deployment)))
    if scene.crowd is not None and len(scene.crowd) == 1:
        points = required_points(half_edge(scene.visibility.sight(camera)), *landmarks)
        seen = scene.crowd.clear(position, points).all(axis=0)
        found["crowd"] = np.broadcast_to(seen, (len(axes), len(deployment)))
    return found


@dataclass(frozen=True)
class Causes:
    """Shares of sightings that meet the criteria. A sighting is a pair of a landmark and a camera in a random pose."""

    sightings: int
    """Number of sightings."""
    covered: float
    """Share of the sightings that meet every criterion."""
    met: Mapping[str, float]
    """Share of the sightings that meet each criterion, keyed by its name."""
    without: Mapping[str, float]
    """Share of the sightings that meet all other criteria, keyed by the name of the criterion that is left out."""
    limits: Mapping[str, str]
    """Text of the limits of each criterion, keyed by the criterion's name."""

    def metrics(self) -> dict[str, float]:
        """Shares of sightings: `covered`, and for each criterion, such as `focus`, `focus_met` and
        `covered_without_focus`.
        """
        met = {f"{name}_met": share for name, share in self.met.items()}
        return {"covered": self.covered} | met | {f"covered_without_{name}": x for name, x in self.without.items()}

    def to_text(self) -> str:
        """Text for a terminal: a row for each criterion. The first row has the criterion that alone excludes the
        largest share of sightings.
        """
        rows = [("criterion", "met by", "covered without it", "limit")]
        for name in sorted(self.without, key=lambda name: -self.without[name]):
            shares = f"{self.met[name]:.2%}", f"{self.without[name]:.2%}"
            rows.append((name.replace("_", " "), *shares, self.limits.get(name, "")))
        width = max(len(name) for name, *_ in rows)
        lines = [f"{name:<{width}}  {met:>7}  {without:>18}  {limit}".rstrip() for name, met, without, limit in rows]
        head = f"{self.covered:.2%} of {self.sightings:,} sightings of single landmarks, from random poses, cover them"
        return "\n".join([head, *lines])


def causes(scene: Scene, deployment: Deployment, seed: int) -> Causes | None:
    """Measure the shares of sightings that meet each criterion.

    Args:
        scene: scene whose visibility model has `verdicts`, as `lmd.sight.models.fiducial.Fiducial` has.
        deployment: K landmarks.
        seed: seed of the poses: positions uniform where the camera may be, orientations from the PDF.

    Returns:
        the shares; None if the model has no verdicts.
    """
    if not hasattr(scene.visibility, "verdicts"):
        return None
    rng = np.random.default_rng([seed, CAUSES_STREAM])
    positions = np.repeat(scene.room.sample(POSITIONS, rng), VIEWS, axis=0)
    poses = camera_pose(positions, *scene.pdf.draw_at(positions, rng)).reshape(POSITIONS, VIEWS, 4, 4)
    names: list[str] = []
    met, without, covered = [], [], 0
    for i, here in enumerate(poses):  # one pose after the other, to save memory
        own = scene if scene.crowd is None else scene.in_state(i % len(scene.crowd))
        for camera, offset, _, axes in scene.stations(axis_and_right(here)):
            found = _verdicts_of(own, camera, deployment, here[0, :3, 3] + offset, axes)
            names, passed = list(found), np.stack(list(found.values()))
            failed = (~passed).sum(axis=0)
            met.append(passed.sum(axis=(1, 2)))
            without.append((failed == ~passed).sum(axis=(1, 2)))  # sightings that fail at most this criterion
            covered += int((failed == 0).sum())
    sightings = len(positions) * len(deployment) * len(scene.cameras)

    def shares(counts: list[IntArray]) -> dict[str, float]:
        return dict(zip(names, (np.sum(counts, axis=0) / sightings).tolist(), strict=True))

    describe = getattr(scene.visibility, "limits_for", None)
    described = [describe(camera) for camera in dict.fromkeys(scene.cameras)] if describe else []
    limits = {name: " | ".join(dict.fromkeys(each[name] for each in described)) for name in (described or [{}])[0]}
    if "obstacles" in names:
        limits["obstacles"] = "nothing of the room in the way"
    if "crowd" in names:
        limits["crowd"] = "no person or robot in the way"
    return Causes(sightings, covered / sightings, shares(met), shares(without), limits)
