"""What a visibility model says of frames, of one camera or of all those of a rig."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmd.core.checks import BoolArray, FloatArray
from lmd.detection.frames import overlapping
from lmd.detection.quality import incidence, pitch
from lmd.render.renderer import Renderer


@dataclass(frozen=True)
class Prediction:
    """N frames of a deployment and what a visibility model says of them.

    Args:
        renderer: the camera in the room with K tags.
        poses: X, `(N, 4, 4)`.
        visible: which tags the model counts as seen, `(N, K)`.
        met: whether each of its criteria is met, `(N, K)` by name; empty where the model cannot say.
        taken: of which frames there is an image, `(N,)`; None for all. Nothing is visible or whole in the others.
    """

    renderer: Renderer
    poses: FloatArray
    visible: BoolArray
    met: Mapping[str, BoolArray]
    taken: BoolArray | None = None

    @property
    def parts(self) -> "tuple[Prediction, ...]":
        """The predictions of each camera: this one alone."""
        return (self,)

    @property
    def mounted(self) -> FloatArray:
        """From the frame of each camera to that of the poses, `(1, 4, 4)`."""
        return np.eye(4)[None]

    def moved(self, poses: FloatArray) -> "Prediction":
        """The prediction for other poses."""
        return replace(self, poses=poses)

    @cached_property
    def corners(self) -> FloatArray:
        """Exact corners, pixels, `(N, K, 4, 2)`."""
        return self.renderer.corners(self.poses)

    @cached_property
    def whole(self) -> BoolArray:
        """Which tags show their front with all corners in the image, `(N, K)`."""
        inside = self.renderer.inside(self.poses)
        return inside if self.taken is None else inside & self.taken[:, None]

    @cached_property
    def pitch(self) -> FloatArray:
        """Pixels a module, `(N, K)`; NaN for what is not wholly in the image."""
        room = self.renderer.room
        values = pitch(self.renderer.camera, self.poses, room.centres, room.normals, room.tag, room.edges)
        return np.where(self.whole, values, np.nan)

    @cached_property
    def incidence(self) -> FloatArray:
        """From the tag's normal to the camera, degrees, `(N, K)`; NaN for what is not wholly in the image."""
        room = self.renderer.room
        return np.where(self.whole, np.degrees(incidence(self.poses, room.centres, room.normals)), np.nan)

    @cached_property
    def overlapping(self) -> BoolArray:
        """Which tags lie over or under another one, `(K,)`."""
        return overlapping(self.renderer.room)


def _beside(name: str) -> cached_property[NDArray[Any]]:
    """What the predictions of all cameras of a `RigPrediction` say, beside each other."""
    return cached_property(lambda rig: np.concatenate([getattr(part, name) for part in rig.parts], axis=1))


@dataclass(frozen=True)
class RigPrediction:
    """N moments of a rig: the predictions of its C cameras beside each other, as of C K tags.

    Args:
        parts: of each camera, with the poses of that camera.
        mounted: where they are on the body (`lmd.scene.rig.Rig.extrinsics`), `(C, 4, 4)`.
        poses: X of the body, `(N, 4, 4)`.
    """

    parts: tuple[Prediction, ...]
    mounted: FloatArray
    poses: FloatArray

    def moved(self, poses: FloatArray) -> "RigPrediction":
        """See `Prediction.moved`."""
        parts = tuple(part.moved(poses @ at) for part, at in zip(self.parts, self.mounted, strict=True))
        return replace(self, parts=parts, poses=poses)

    # See `Prediction`, each `(N, C K)`.
    visible = _beside("visible")
    corners = _beside("corners")
    whole = _beside("whole")
    pitch = _beside("pitch")
    incidence = _beside("incidence")

    @cached_property
    def met(self) -> Mapping[str, BoolArray]:
        """See `Prediction`."""
        names = self.parts[0].met
        return {name: np.concatenate([part.met[name] for part in self.parts], axis=1) for name in names}

    @cached_property
    def overlapping(self) -> BoolArray:
        """See `Prediction`."""
        return np.tile(self.parts[0].overlapping, len(self.parts))


Predicted = Prediction | RigPrediction
