"""Rendered frames of a deployment, and detections in the frames."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.detection.corner_errors import apparent_edge, incidence, pitch
from lmd.detection.detectors import Detector, Matches, match
from lmd.geometry.camera import Camera
from lmd.geometry.projection import blur_sigma, to_camera
from lmd.geometry.se3 import camera_pose
from lmd.render.imaging import Imaging, UInt8Array
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom
from lmd.scene.deployment import Deployment
from lmd.scene.pushing import TOUCHING
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.space.space import Space

# Key that separates the random numbers of poses and noise from other uses of a seed.
FRAMES_STREAM = 0x646574656374


def draw_poses(scene: Scene, count: int, seed: int) -> FloatArray:
    """Draw camera poses (camera to world), `(count, 4, 4)`: positions uniform in the reachable volume, orientations
    from the orientation PDF.

    The poses are independent of the deployment.
    """
    rng = np.random.default_rng([seed, FRAMES_STREAM])
    positions = scene.room.sample(count, rng)
    return camera_pose(positions, *scene.pdf.draw_at(positions, rng))


def draw_crowd(scene: Scene, positions: FloatArray, seed: int) -> tuple[Scene, list[FloatArray] | None]:
    """Draw a new crowd for each of N frames.

    Args:
        scene: the scene.
        positions: positions of the camera, `(N, 3)`, metres.
        seed: seed of the crowds.

    Returns:
        scene with N crowd states, one for each frame; and for each frame the people around the camera as cylinders (x,
        y, radius, lower and upper z, metres), `(M, 5)`. The second result is None for a scene without a crowd.
    """
    if scene.crowd is None:
        return scene, None
    each = replace(scene.crowd.crowd, states=len(positions), fitness="mean")
    crowd = each.drawn(scene.room, np.random.default_rng([seed, FRAMES_STREAM, 2]))
    present = crowd.present(positions, np.arange(len(positions)))
    return replace(scene, crowd=crowd), [people[here] for people, here in zip(crowd.people, present, strict=True)]


def tagged_room(room: Space, deployment: Deployment, tag: Tag) -> TaggedRoom:
    """Surfaces of a room with the tags of a deployment on them, for the renderer.

    Raises:
        InputError: landmarks are points, or the tag family lacks the id of a landmark.
    """
    tag.check_ids(deployment.ids)
    places = deployment.positions, deployment.normals, deployment.ups
    return TaggedRoom(tag, deployment.ids, *places, room.faces(), deployment.edges_of(tag))


def qualities(renderer: Renderer, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Measures of image quality of each of K tags in N frames, `(N, K)` each: pitch (pixels per module), incidence
    angle (rad), apparent edge length (pixels), and standard deviation of the blur (pixels). `Limits.found` decides from
    these values which tags are detected.

    Args:
        renderer: camera and tags.
        poses: poses of the camera, camera to world, `(N, 4, 4)`.
    """
    room, camera, imaging = renderer.room, renderer.camera, renderer.imaging
    where, size = (poses, room.centres, room.normals), (room.tag, room.edges)
    depth = to_camera(poses, room.centres)[..., 2]
    depth = np.where(depth > 0.0, depth, np.nan)
    edges = apparent_edge(camera, *where, *size)
    return pitch(camera, *where, *size), incidence(*where), edges, blur(camera, depth, imaging)


def blur(camera: Camera, depth: FloatArray, imaging: Imaging) -> FloatArray:
    """Standard deviation of the blur of points due to optics, defocus and motion together, pixels, in the shape of
    `depth`.

    `depth` has the depths of the points in front of the camera, metres.
    """
    sigma = blur_sigma(camera, depth, imaging.psf_sigma) if imaging.defocus else np.full_like(depth, imaging.psf_sigma)
    return np.hypot(sigma, imaging.motion_blur / math.sqrt(12.0))  # motion blur has a uniform distribution


def overlapping(room: TaggedRoom) -> BoolArray:
    """Mask of the tags that overlap another tag in the plane of both, `(K,)`. Quiet zones (white margins) are part of
    the tags.
    """
    right = np.cross(room.ups, room.normals)
    offset = room.centres[None] - room.centres[:, None]  # from k to j, (K, K, 3)
    a, b, c = (np.abs((offset * axis[:, None]).sum(axis=-1)) for axis in (right, room.ups, room.normals))
    parallel = room.normals @ room.normals.T > 1.0 - 1e-6
    footprints = room.tag.paper_share * room.edges
    over = parallel & (c < 1e-3) & (np.maximum(a, b) < (footprints[:, None] + footprints) / 2.0 * (1.0 - TOUCHING))
    np.fill_diagonal(over, False)
    return np.asarray(over.any(axis=1))


def rendered_frame(renderer: Renderer, pose: FloatArray, number: int, seed: int) -> UInt8Array:
    """Render frame `number` as a grey image `(h, w)`; the noise depends only on `number` and `seed`."""
    return renderer.frame(pose, np.random.default_rng([seed, FRAMES_STREAM, number]))


def detect_in_frames(
    renderer: Renderer,
    detectors: Mapping[str, Detector],
    poses: FloatArray,
    first: int,
    seed: int,
    people: Sequence[FloatArray] | None = None,
) -> dict[str, Matches]:
    """Render frames and run every detector on each frame.

    Args:
        renderer: camera in the room.
        detectors: detectors, keyed by name.
        poses: poses of the camera in the frames, camera to world, `(N, 4, 4)`.
        first: number of the first frame.
        seed: seed of the noise.
        people: for each frame, the people around the camera as cylinders (x, y, radius, lower and upper z, metres),
            `(M, 5)`; None without a crowd.

    Returns:
        matches in the frames, keyed by the name of the detector.
    """
    expected, ids = renderer.corners(poses), renderer.room.ids
    matches: dict[str, list[Matches]] = {name: [] for name in detectors}
    for i, pose in enumerate(poses):
        among = renderer if people is None else replace(renderer, room=renderer.room.among(people[i]))
        image = rendered_frame(among, pose, first + i, seed)
        for name, detector in detectors.items():
            matches[name].append(match(detector.detect(image), ids, expected[i]))
    return {name: Matches.stacked(found) for name, found in matches.items()}
