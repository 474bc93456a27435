"""Measurements by a real detector that reads rendered frames."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from typing import NamedTuple

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, IntArray, check_fields, real
from lmd.detection.detectors import Detections, Detector
from lmd.detection.frames import tagged_room
from lmd.estimation.recording import Each, Flight, Look, Observation, check_images, merged
from lmd.estimation.sensors import corners_of, observation
from lmd.geometry.se3 import adjoint, inverse
from lmd.render.imaging import Imaging, UInt8Array
from lmd.render.renderer import Renderer
from lmd.scene.deployment import Deployment
from lmd.scene.tag import Tag

# Frames that are rendered and read in one go.
FRAME_BATCH = 10


class Frame(NamedTuple):
    """A frame to be rendered: X `(4, 4)`, the camera's motion meanwhile `(6,)` or None, and the source of its noise."""

    pose: FloatArray
    motion: FloatArray | None
    rng: np.random.Generator


class Moment(NamedTuple):
    """A frame of a flight beside what was predicted and found in it.

    Args:
        time: seconds.
        pose: X, `(4, 4)`.
        image: `(h, w)`.
        expected: exact corners of the K tags, pixels from the border, `(K, 4, 2)`; NaN behind the camera.
        predicted: which tags the visibility model counts as seen, `(K,)`.
        found: corners as detected, `(K, 4, 2)`; NaN where not detected.
    """

    time: float
    pose: FloatArray
    image: UInt8Array
    expected: FloatArray
    predicted: BoolArray
    found: FloatArray


@dataclass(frozen=True)
class RenderedDetector:
    """What a detector finds of tags in rendered frames, missing and false ones included; a `Sensor`.

    A tag's place in the camera's frame comes from its own four corners. A detection with the id of a tag is believed,
    wherever it is; of two with the same id the larger one. Ids that hang nowhere are left out.

    Args:
        tag: at every landmark, upright.
        reader: reads the frames.
        imaging: lens, light and noise.
        pixel_noise: standard deviation of corners that estimators are told, pixels.
        shutter: how long it is open for a frame, seconds; the camera's motion meanwhile blurs the frame.

    Raises:
        InputError: the tag is a point, the noise is not positive, or the shutter's time negative.
    """

    tag: Tag
    reader: Detector
    imaging: Imaging
    pixel_noise: float = 0.5
    shutter: float = 0.0

    def __post_init__(self) -> None:
        self.tag.check_edge()
        check_fields(self, real, "pixel_noise", above=0.0)
        check_fields(self, real, "shutter", low=0.0)

    def tags(self, deployment: Deployment) -> FloatArray:
        """See `Sensor.tags`."""
        return corners_of(deployment, self.tag)

    def batch(self, look: Look) -> "Batch":
        """The frames of a camera; rendered from a flight with the same source of noise they are the same."""
        flight = look.flight
        room = tagged_room(flight.evaluator.scene.room, flight.deployment, self.tag)
        twists = adjoint(inverse(look.mounted), flight.trajectory.twists)
        motions = self.shutter * np.concatenate([twists, twists[-1:]])  # at the end as in the step before
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
        return [
            merged(
                [self._observed(look, list(islice(found, len(look.in_view)))) for look in those],
                f.camera.extrinsics,
            )
            for f, those in zip(flights, looks, strict=True)
        ]

    def moments(self, look: Look, frames: Sequence[int]) -> list[Moment]:
        """Some frames of a camera, to look at."""
        flight, poses = look.flight, look.poses
        whole, sight, times = self.batch(look), look.in_view, flight.trajectory.time
        chosen = whole._replace(frames=[whole.frames[t] for t in frames])
        pictures = list(images(chosen))
        found = believed([self.reader.detect(picture) for picture in pictures], flight.deployment.ids)
        return [
            Moment(times[t], poses[t], picture, whole.renderer.corners(poses[t]), sight[t], corners)
            for t, picture, corners in zip(frames, pictures, found, strict=True)
        ]

    def _observed(self, look: Look, found: Sequence[Detections]) -> Observation:
        corners = believed(found, look.flight.deployment.ids)
        seen = np.isfinite(corners[..., 0, 0])
        noise, edges = np.full(int(seen.sum()), self.pixel_noise), look.flight.deployment.edges_of(self.tag)
        return observation(look.camera, edges, seen, corners[seen], noise)


class Batch(NamedTuple):
    """Frames of one camera, for a process of its own."""

    renderer: Renderer
    reader: Detector
    frames: Sequence[Frame]


def images(batch: Batch) -> Iterator[UInt8Array]:
    """The frames of a batch, `(h, w)` each; this uses up their sources of noise."""
    return (batch.renderer.frame(frame.pose, frame.rng, frame.motion) for frame in batch.frames)


def read(batch: Batch) -> list[Detections]:
    """What the reader finds in each frame of a batch."""
    return [batch.reader.detect(image) for image in images(batch)]


def believed(found: Sequence[Detections], ids: IntArray) -> FloatArray:
    """Corners found in T frames of the tags with `ids` `(K,)`, pixels, `(T, K, 4, 2)`; NaN for a tag not found."""
    corners, place = np.full((len(found), len(ids), 4, 2), np.nan), {number: k for k, number in enumerate(ids.tolist())}
    for t, detections in enumerate(found):
        edges = detections.corners - np.roll(detections.corners, 1, axis=1)
        for i in np.argsort((edges**2).sum(axis=(1, 2)), kind="stable"):  # the larger one comes last, and stays
            if (k := place.get(int(detections.ids[i]))) is not None:
                corners[t, k] = detections.corners[i]
    return corners
