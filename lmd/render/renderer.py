"""Frames of a camera in a room with tags."""

import math
from dataclasses import dataclass, field

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.geometry.camera import Camera
from lmd.geometry.projection import blur_sigma, depth_in_focus, image_size, project, to_camera
from lmd.geometry.se3 import exp
from lmd.render.canvas import NEAR_PLANE, Canvas, covering
from lmd.render.faces import Face, assembled, faces_of
from lmd.render.imaging import Float32Array, Imaging, UInt8Array
from lmd.render.room import Surface, TaggedRoom

# Pictures averaged to one with motion blur, at most.
MOST_STEPS = 64
# A tag this far (m) behind a surface hangs on it; farther, the surface hides it.
FLUSH = 1e-3


@dataclass(frozen=True)
class Renderer:
    """A camera in a room.

    Args:
        camera: intrinsics.
        room: tags and surfaces.
        imaging: light, lens and noise.
    """

    camera: Camera
    room: TaggedRoom
    imaging: Imaging = field(default_factory=Imaging)

    def frame(self, pose: FloatArray, rng: np.random.Generator, motion: FloatArray | None = None) -> UInt8Array:
        """The image from a pose.

        Args:
            pose: X, camera to world, `(4, 4)`.
            rng: source of the noise, and of the motion's direction.
            motion: how far the camera moves while the shutter is open, a body twist (w, v) times the exposure time,
                rad and metres, `(6,)`; `pose` is in the middle of it. None for that of `imaging`.

        Returns:
            `(h, w)`.
        """
        if motion is None and self.imaging.motion_blur > 0.0:
            motion = self._turn(rng)
        lights = self._lights(pose) if motion is None else self._moving(pose, np.asarray(motion, dtype=np.float64))
        return self.imaging.develop(assembled(faces_of(self.camera), lights), rng)

    def corners(self, pose: FloatArray) -> FloatArray:
        """Exact images of the tags' corners from poses `(..., 4, 4)`, pixels from the border, `(..., K, 4, 2)`.

        Includes tags outside the image, turned away or hidden; NaN as in `lmd.geometry.projection.project`.
        """
        flat = project(self.camera, pose, self.room.corners.reshape(-1, 3))
        return flat.reshape(*flat.shape[:-2], -1, 4, 2)

    def inside(self, pose: FloatArray, margin: float = 0.0) -> BoolArray:
        """Which tags show their front with four corners at least `margin` pixels inside the image, `(..., K)`."""
        room, size = self.room, np.array(image_size(self.camera))
        image = self.corners(pose)
        within = ((image >= margin) & (image <= size - margin)).all(axis=(-2, -1))
        towards = pose[..., None, :3, 3] - room.centres
        return np.asarray(within & ((towards * room.normals).sum(axis=-1) > 0.0))

    def _lights(self, pose: FloatArray) -> list[Float32Array]:
        """What falls on the faces of the image from one pose."""
        return [self._light(pose, face) for face in faces_of(self.camera)]

    def _light(self, from_camera: FloatArray, face: Face) -> Float32Array:
        """What falls on one face."""
        pose = from_camera.copy()
        pose[:3, :3] = from_camera[:3, :3] @ face.turn.T
        canvas = Canvas(face.matrix, face.size, self.imaging)
        position, room = pose[:3, 3], self.room
        seen = [(s, part) for s in room.surfaces if (position - s.origin) @ s.normal > 0.0 for part in s.parts]
        seen.sort(key=lambda one: -float(np.linalg.norm(_middle(*one) - position)))
        outlines = []
        for s, part in seen:
            plane = (np.stack([s.u, s.v, s.origin - position]) @ pose[:3, :3]).T
            outlines.append(canvas.surface(plane, part, float(self.imaging.shade(s.normal)), self._pattern))
        if seen:
            canvas.blur(self.imaging.psf_sigma)
        squares = to_camera(pose, room.corners.reshape(-1, 3)).reshape(-1, 4, 3)
        offset = position - room.centres
        front = ((offset * room.normals).sum(axis=1) > 0.0) & (squares[..., 2] > NEAR_PLANE).any(axis=1)
        for k in sorted(np.flatnonzero(front), key=lambda k: -float(np.linalg.norm(offset[k]))):
            depth = np.array([(room.centres[k] - s.origin) @ s.normal for s, _ in seen])
            hidden_by = [outlines[i] for i in np.flatnonzero(depth < -FLUSH)]
            canvas.tag(room.tag, int(room.ids[k]), squares[k], self._sigma(squares[k], face), hidden_by)
        return canvas.light

    def _sigma(self, square: FloatArray, face: Face) -> float:
        """Blur of a tag in a face, by how far its centre is, pixels.

        What the lens shrinks it must blur more, so that it is blurred as said once it is bent.
        """
        centre, sigma, camera = face.turn.T @ square.mean(axis=0), self.imaging.psf_sigma, self.camera
        if self.imaging.defocus:
            sigma = float(blur_sigma(camera, max(float(depth_in_focus(camera, centre)), NEAR_PLANE), sigma))
        return sigma / face.scale(camera, centre)

    def _turn(self, rng: np.random.Generator) -> FloatArray:
        """A turn in a random direction that moves the middle of the image by `Imaging.motion_blur`, as `motion`."""
        direction = rng.uniform(0.0, 2.0 * math.pi)
        shift = self.imaging.motion_blur * np.array([math.cos(direction), math.sin(direction)])
        right, down = shift / self.camera.focal_pixels
        return np.array([down, -right, 0.0, 0.0, 0.0, 0.0])

    def _moving(self, pose: FloatArray, motion: FloatArray) -> list[Float32Array]:
        """The mean over the motion, in steps of about a pixel."""
        ends = [self.corners(pose @ exp(t * motion))[self.inside(pose)] for t in (-0.5, 0.5)]
        shift = np.linalg.norm(ends[1] - ends[0], axis=-1)
        longest = float(np.nanmax(shift)) if np.isfinite(shift).any() else 0.0
        steps = min(1 + math.ceil(longest), MOST_STEPS)
        lights = self._lights(pose @ exp((0.5 / steps - 0.5) * motion))
        for i in range(1, steps):
            for light, more in zip(lights, self._lights(pose @ exp(((i + 0.5) / steps - 0.5) * motion)), strict=True):
                light += more
        return [light / np.float32(steps) for light in lights]

    @property
    def _pattern(self) -> Float32Array | None:
        """The pattern on every surface."""
        if self.imaging.texture == 0.0:
            return None
        longest = max((float(surface.parts.max()) for surface in self.room.surfaces), default=0.0)
        return covering(self.imaging.texture, self.imaging.texture_seed, longest)


def _middle(surface: Surface, part: FloatArray) -> FloatArray:
    """The middle of the box around a part of a surface, world frame, metres, `(3,)`."""
    a, b = (part.min(axis=0) + part.max(axis=0)) / 2.0
    return np.asarray(surface.origin + a * surface.u + b * surface.v)
