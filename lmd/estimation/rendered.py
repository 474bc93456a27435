"""Sensor that runs a real detector on rendered frames."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from typing import NamedTuple

import numpy as np

from lmd.core.checks import Checked, FloatArray, InputError, IntArray, NotNegative, Positive
from lmd.detection.corner_errors import inward, shortest_side
from lmd.detection.detectors import Detections, Detector
from lmd.detection.frames import tagged_room
from lmd.estimation.recording import Each, Flight, Look, Observation, check_images, merged
from lmd.estimation.sensors import corners_of, observation
from lmd.geometry.se3 import adjoint, inverse
from lmd.render.imaging import Imaging, UInt8Array
from lmd.render.renderer import Renderer
from lmd.scene.deployment import Deployment
from lmd.scene.tag import Tag

# Number of frames in a job for a process.
FRAME_BATCH = 10


class Frame(NamedTuple):
    """A frame to render."""

    pose: FloatArray
    """Pose X of the camera, `(4, 4)`."""
    motion: FloatArray | None
    """Body twist times the exposure time, `(6,)`; None for no motion."""
    rng: np.random.Generator
    """Random generator of the noise."""


@dataclass(frozen=True)
class RenderedDetector(Checked):
    """Real detector on rendered frames, with missed and false detections; a `Sensor`.

    The mean shift of a tag's edges by the detector is subtracted from the corners, as a calibration would do. The
    position of a tag follows from its corners. Every detection with the id of a tag is accepted; if a frame has several
    detections with one id, only the largest is accepted. Other ids are ignored.

    Raises:
        InputError: the tag is a point, the detector has no `corner_errors`, the noise is not positive, or the shutter
            time is negative.
    """

    tag: Tag
    """Tag at every landmark; tags hang upright."""
    reader: Detector
    """Detector that reads the frames."""
    imaging: Imaging
    """Lens, light and noise."""
    pixel_noise: Positive | None = None
    """Standard deviation of the corners as estimators assume it, pixels; None for the measured standard deviation of
    the detector, which depends on the pitch.
    """
    shutter: NotNegative = 0.0
    """Exposure time, seconds; the motion of the camera blurs the frame."""

    def _validate(self) -> None:
        self.tag.check_edge()
        if not hasattr(self.reader, "corner_errors"):
            raise InputError(f"reader must have corner_errors; {type(self.reader).__name__} has none.", "reader")

    def tags(self, deployment: Deployment) -> FloatArray:
        """See `Sensor.tags`."""
        return corners_of(deployment, self.tag)

    def batch(self, look: Look) -> "Batch":
        """Make the batch of the frames that one camera takes on a flight.

        Flights whose random generators `rng` are in equal states give equal frames.
        """
        flight = look.flight
        room = tagged_room(flight.evaluator.scene.room, flight.deployment, self.tag)
        twists = adjoint(inverse(look.mounted), flight.trajectory.twists)
        motions = self.shutter * np.concatenate([twists, twists[-1:]])  # the last twist is repeated for the last frame
        moving = motions if self.shutter > 0.0 else [None] * len(motions)
        frames = zip(look.poses, moving, flight.rng.spawn(len(motions)), strict=True)
        return Batch(Renderer(look.camera, room, self.imaging), self.reader, [Frame(*frame) for frame in frames])

    def observed(self, flights: Sequence[Flight], each: Each = map) -> list[Observation]:
        """See `Sensor.observed`; `each` gets batches of frames."""
        check_images(flights)
        looks = [flight.looks() for flight in flights]
        jobs = [
            whole._replace(frames=whole.frames[first : first + FRAME_BATCH])
            for whole in map(self.batch, chain.from_iterable(looks))
            for first in range(0, len(whole.frames), FRAME_BATCH)
        ]
        found = iter([detections for batch in each(read, jobs) for detections in batch])
        seen = [[self._observed(look, list(islice(found, len(look.in_view)))) for look in those] for those in looks]
        return [merged(parts, flight.camera.extrinsics) for flight, parts in zip(flights, seen, strict=True)]

    def _observed(self, look: Look, found: Sequence[Detections]) -> Observation:
        corners = believed(found, look.flight.deployment.ids)
        seen = np.isfinite(corners[..., 0, 0])
        image, errors, edges = corners[seen], self.reader.corner_errors, look.flight.deployment.edges_of(self.tag)
        pitch = shortest_side(image) / self.tag.modules
        image = image - errors.inward_at(pitch)[:, None, None] * inward(image)
        noise = errors.independent_sigma(pitch) if self.pixel_noise is None else np.full(len(image), self.pixel_noise)
        return observation(look.camera, edges, seen, image, noise)


class Batch(NamedTuple):
    """Frames of one camera, which one process renders and in which it detects tags."""

    renderer: Renderer
    """Renderer of the camera."""
    reader: Detector
    """Detector that reads the frames."""
    frames: Sequence[Frame]
    """Frames to render."""


def images(batch: Batch) -> Iterator[UInt8Array]:
    """Render the frames of a batch, `(h, w)` each.

    A second call gives other noise, as random numbers are drawn from the generator `rng` of each frame.
    """
    return (batch.renderer.frame(frame.pose, frame.rng, frame.motion) for frame in batch.frames)


def read(batch: Batch) -> list[Detections]:
    """Detections in each frame of a batch."""
    return [batch.reader.detect(image) for image in images(batch)]


def believed(found: Sequence[Detections], ids: IntArray) -> FloatArray:
    """Corners of the tags with the ids `ids` `(K,)` as detected in T frames, pixels, `(T, K, 4, 2)`; NaN for tags that
    are not detected. The largest of several detections with one id is taken.
    """
    corners, place = np.full((len(found), len(ids), 4, 2), np.nan), {number: k for k, number in enumerate(ids.tolist())}
    for t, detections in enumerate(found):
        edges = detections.corners - np.roll(detections.corners, 1, axis=1)
        for i in np.argsort((edges**2).sum(axis=(1, 2)), kind="stable"):  # the largest is assigned last and wins
            if (k := place.get(int(detections.ids[i]))) is not None:
                corners[t, k] = detections.corners[i]
    return corners
