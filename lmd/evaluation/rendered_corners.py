"""Errors of tag corners, measured by a real detector in rendered images of a deployment."""

from collections.abc import Callable, Mapping

import numpy as np

from lmd.core.checks import InputError
from lmd.detection.corner_errors import MeasuredCorners, incidence, pitch
from lmd.detection.detectors import AprilTagDetector, ArucoDetector, Detector
from lmd.detection.frames import detect_in_frames, draw_poses, tagged_room
from lmd.geometry.projection import image_size, project
from lmd.geometry.se3 import axis_and_right
from lmd.geometry.squares import corners
from lmd.problem import Problem
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.scene.deployment import Deployment
from lmd.sight.views import visible_to_each

READERS: Mapping[str, Callable[[str], Detector]] = {
    "aruco": lambda family: ArucoDetector(family),
    "apriltag": lambda family: AprilTagDetector(family),
    "apriltag_decimate2": lambda family: AprilTagDetector(family, quad_decimate=2.0),
}
TEXTURE = 4.0  # standard deviation of the pattern on surfaces, grey levels
CANDIDATES = 20  # number of random poses drawn for each rendered frame
# Least distance of the corners from the border of the image, pixels; detectors misplace corners that are cut off.
BORDER = 2.0
CORNERS_STREAM = 0x636F726E  # separates the random numbers of these frames from other uses of the seed


def imaging_of(problem: Problem) -> Imaging:
    """Settings for rendering images, with the blur that the problem's visibility model assumes."""
    blur = {name: getattr(problem.scene.visibility, name, None) for name in ("psf_sigma", "motion_blur")}
    return Imaging(texture=TEXTURE, **{name: value for name, value in blur.items() if value is not None})


def measured_corners(problem: Problem, deployment: Deployment, reader: str, frames: int, seed: int) -> MeasuredCorners:
    """Measure the errors of detected corners in rendered frames. The camera poses are random, but must show at least n
    tags, with the objective's n.

    Args:
        problem: problem with the scene.
        deployment: K tags.
        reader: name of the detector, one of `READERS`.
        frames: number of frames of each camera.
        seed: seed of the poses and of the pixel noise.

    Raises:
        InputError: the detector is unknown, or too few tags are detected.
    """
    if reader not in READERS:
        raise InputError("corners = rendered needs a fiducial visibility model with a known detector.", "corners")
    scene, tag = problem.scene, problem.scene.tag
    poses = draw_poses(scene, CANDIDATES * frames, seed + CORNERS_STREAM)
    seen = visible_to_each(problem.evaluator, deployment, poses[:, :3, 3], axis_and_right(poses))
    room, detector = tagged_room(scene.room, deployment, tag), READERS[reader](tag.family)
    edges = deployment.edges_of(tag)
    points = corners(deployment.places, deployment.normals, deployment.ups, edges)
    parts = []
    for camera, mounted, mask in zip(scene.cameras, scene.extrinsics, seen, strict=True):
        at = (poses @ mounted)[np.flatnonzero(mask.sum(axis=1) >= problem.objective.n)[:frames]]
        if not len(at):
            continue
        found = detect_in_frames(Renderer(camera, room, imaging_of(problem)), {reader: detector}, at, 0, seed)[reader]
        image = project(camera, at, points.reshape(-1, 3)).reshape(len(at), *points.shape[:2], 2)
        with np.errstate(invalid="ignore"):  # tags behind the camera
            clear = ((image > BORDER) & (image < np.array(image_size(camera)) - BORDER)).all(axis=(2, 3))
        own = found.detected & clear
        where = at, deployment.places, deployment.normals
        parts.append((
            pitch(camera, *where, tag, edges)[own], incidence(*where)[own], (found.corners - image)[own], image[own],
        ))  # fmt: skip
    if not parts:
        raise InputError(f"frames: none of the random poses sees {problem.objective.n} tags.", "frames")
    pitches, incidences, errors, images = (np.concatenate([part[i] for part in parts]) for i in range(4))
    return MeasuredCorners.of(pitches, incidences, errors, images)
