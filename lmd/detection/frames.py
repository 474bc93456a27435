"""Detectors on rendered frames of a deployment."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.detection.detectors import Detector
from lmd.detection.evaluation import Matches, match
from lmd.detection.quality import apparent_edge, incidence, pitch
from lmd.geometry.camera import Camera
from lmd.geometry.projection import blur_sigma, to_camera
from lmd.geometry.se3 import camera_pose, exp
from lmd.render.imaging import Imaging, UInt8Array
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom
from lmd.scene.deployment import Deployment
from lmd.scene.pushing import TOUCHING
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.space.space import Space

# Keeps the poses and the noise apart from every other use of the same seed.
FRAMES_STREAM = 0x646574656374


def draw_poses(scene: Scene, count: int, seed: int) -> FloatArray:
    """Draw poses X, `(count, 4, 4)`: positions uniformly where the camera may be, orientations from the PDF.

    They do not depend on what hangs in the room.
    """
    rng = np.random.default_rng([seed, FRAMES_STREAM])
    positions = scene.room.sample(count, rng)
    return camera_pose(positions, *scene.pdf.draw_at(positions, rng))


def nudged(poses: FloatArray, position: float, attitude: float, seed: int) -> FloatArray:
    """The poses `(N, 4, 4)`, each moved a little at random.

    Args:
        poses: X.
        position, attitude: standard deviations along and about each axis, metres and rad.
    """
    rng = np.random.default_rng([seed, FRAMES_STREAM, 1])
    turns, shifts = rng.normal(0.0, attitude, (len(poses), 3)), rng.normal(0.0, position, (len(poses), 3))
    return np.asarray(poses @ exp(np.hstack([turns, shifts])))


def tagged_room(room: Space, deployment: Deployment, tag: Tag) -> TaggedRoom:
    """A deployment with tag k at the landmark with the id k, as it hangs, in a room of surfaces.

    Raises:
        InputError: the tag is a point, or its family is too small.
    """
    tag.check_ids(deployment.ids)
    places = deployment.positions, deployment.normals, deployment.ups
    return TaggedRoom(tag, deployment.ids, *places, room.faces(), deployment.edges_of(tag))


def qualities(renderer: Renderer, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Pitch, incidence, edge and sigma of every tag, `(N, K)` each, as `Limits.found` takes them.

    Args:
        renderer: the camera and the tags.
        poses: X, `(N, 4, 4)`.
    """
    room, camera, imaging = renderer.room, renderer.camera, renderer.imaging
    where, size = (poses, room.centres, room.normals), (room.tag, room.edges)
    depth = to_camera(poses, room.centres)[..., 2]
    depth = np.where(depth > 0.0, depth, np.nan)
    edges = apparent_edge(camera, *where, *size)
    return pitch(camera, *where, *size), incidence(*where), edges, blur(camera, depth, imaging)


def blur(camera: Camera, depth: FloatArray, imaging: Imaging) -> FloatArray:
    """Standard deviation of the whole blur of what is at `depth`, metres, pixels, as `depth`."""
    sigma = blur_sigma(camera, depth, imaging.psf_sigma) if imaging.defocus else np.full_like(depth, imaging.psf_sigma)
    return np.hypot(sigma, imaging.motion_blur / math.sqrt(12.0))  # of a smear with sharp ends


def overlapping(room: TaggedRoom) -> BoolArray:
    """Which tags lie, with their quiet zones, over or under another one in the same plane, `(K,)`."""
    right = np.cross(room.ups, room.normals)
    offset = room.centres[None] - room.centres[:, None]  # from k to j, (K, K, 3)
    a, b, c = (np.abs((offset * axis[:, None]).sum(axis=-1)) for axis in (right, room.ups, room.normals))
    same_way = room.normals @ room.normals.T > 1.0 - 1e-6
    papers = room.tag.paper_share * room.edges
    over = same_way & (c < 1e-3) & (np.maximum(a, b) < (papers[:, None] + papers) / 2.0 * (1.0 - TOUCHING))
    np.fill_diagonal(over, False)
    return np.asarray(over.any(axis=1))


@dataclass(frozen=True)
class Sightings:
    """What one detector made of N frames of K tags.

    Args:
        detected: with the right id in the right place, `(N, K)`.
        corners: as found, pixels, `(N, K, 4, 2)`; NaN where not detected.
        false: detections of no tag of the room, or of one that is elsewhere, `(N,)`.
    """

    detected: BoolArray
    corners: FloatArray
    false: IntArray

    @classmethod
    def joined(cls, parts: "Sequence[Sightings]") -> "Sightings":
        """The sightings of several parts, one after the other."""
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in cls.__dataclass_fields__))

    @classmethod
    def beside(cls, parts: "Sequence[Sightings]") -> "Sightings":
        """The sightings of all cameras of a rig side by side, `(N, C K)`: N moments, K tags for each camera."""
        detected = np.concatenate([part.detected for part in parts], axis=1)
        corners = np.concatenate([part.corners for part in parts], axis=1)
        return cls(detected, corners, np.sum([part.false for part in parts], axis=0))


def picture(renderer: Renderer, pose: FloatArray, number: int, seed: int) -> UInt8Array:
    """Frame `number` of a run with this seed, the same wherever it is rendered, `(h, w)`."""
    return renderer.frame(pose, np.random.default_rng([seed, FRAMES_STREAM, number]))


def look(
    renderer: Renderer, detectors: Mapping[str, Detector], poses: FloatArray, first: int, seed: int
) -> dict[str, Sightings]:
    """Render frames and let every detector read each.

    Args:
        renderer: the camera in the room.
        detectors: by name.
        poses: X of the frames, `(N, 4, 4)`.
        first: number of the first of them; the noise of a frame depends on its number.

    Returns:
        Sightings by the detector's name.
    """
    expected, ids = renderer.corners(poses), renderer.room.ids
    matches: dict[str, list[Matches]] = {name: [] for name in detectors}
    for i, pose in enumerate(poses):
        image = picture(renderer, pose, first + i, seed)
        for name, detector in detectors.items():
            matches[name].append(match(detector.detect(image), ids, expected[i]))
    return {
        name: Sightings(
            np.stack([m.detected for m in found]),
            np.stack([m.corners for m in found]),
            np.array([m.false for m in found]),
        )
        for name, found in matches.items()
    }
