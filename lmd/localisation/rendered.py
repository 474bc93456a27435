"""Measurements by a real detector that reads rendered frames."""

from dataclasses import dataclass

import numpy as np

from lmd.camera import Camera
from lmd.checks import BoolArray, FloatArray, InputError, real
from lmd.deployment import Deployment
from lmd.detection import detectors
from lmd.detection.frames import tagged_room
from lmd.optional import optional
from lmd.render.imaging import Imaging
from lmd.render.optics import intrinsics, rectified
from lmd.render.renderer import Renderer
from lmd.sight.evaluator import Evaluator
from lmd.tag import CORNERS, Tag


@dataclass(frozen=True)
class RenderedDetector:
    """What a detector finds of tags in rendered frames, missing and false ones included; a `measurements.Sensor`.

    A tag's place in the camera's frame comes from its own four corners. A detection with the id of a tag is believed,
    wherever it is; of two with the same id the larger one. Ids that hang nowhere are left out.

    Args:
        tag: at every landmark, upright.
        reader: reads the frames.
        imaging: lens, light and noise.
        pixel_noise: standard deviation of corners that `bound` and `iekf` are told, pixels.

    Raises:
        InputError: the tag is a point, or the noise is not positive.
    """

    tag: Tag
    reader: detectors.Detector
    imaging: Imaging
    pixel_noise: float = 0.5

    def __post_init__(self) -> None:
        if self.tag.is_point:
            raise InputError("edge must be given, in metres: a detector cannot read a point.", "edge").within("tag")
        object.__setattr__(self, "pixel_noise", real("pixel_noise", self.pixel_noise, above=0.0))

    @property
    def edge(self) -> float:
        """Of a tag, metres."""
        return self.tag.size

    def observed(
        self,
        evaluator: Evaluator,
        camera: Camera,
        deployment: Deployment,
        poses: FloatArray,
        rng: np.random.Generator,
        all_visible: bool,
    ) -> tuple[BoolArray, FloatArray]:
        """See `Sensor.observed`."""
        renderer = Renderer(camera, tagged_room(evaluator.scene.room, deployment, self.tag), self.imaging)
        seen = np.zeros((len(poses), len(deployment)), dtype=np.bool_)
        points = np.zeros((*seen.shape, 3))
        for t, pose in enumerate(poses):
            found = self.reader.detect(renderer.frame(pose, rng))
            edges = found.corners - np.roll(found.corners, 1, axis=1)
            for i in np.argsort((edges**2).sum(axis=(1, 2)), kind="stable"):  # the larger one comes last, and stays
                k = int(found.ids[i])
                if k < len(deployment):
                    seen[t, k], points[t, k] = True, self._place(camera, found.corners[i])
        return seen, points

    def _place(self, camera: Camera, corners: FloatArray) -> FloatArray:
        """The centre of a tag in the camera's frame, metres, `(3,)`, from its corners `(4, 2)`, pixels."""
        cv2 = optional("cv2", "detection")
        matrix, image = intrinsics(camera), np.ascontiguousarray(rectified(camera, corners))
        square = np.pad(CORNERS * self.tag.size / 2.0, ((0, 0), (0, 1)))
        _, _, shift = cv2.solvePnP(square, image, matrix, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
        return np.asarray(shift).reshape(3)
