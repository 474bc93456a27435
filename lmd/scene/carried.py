"""A rig of one camera as that camera alone, for what works with the image of a single camera."""

from dataclasses import dataclass, replace

import numpy as np
from typing_extensions import override

from lmd.core.checks import FloatArray
from lmd.geometry.frames import angles_of, rotation
from lmd.scene.pdf import OrientationPdf
from lmd.scene.rig import SAME_PLACE_DECIMALS, Rig
from lmd.scene.scene import Scene
from lmd.space.carried import Carried, Offsets


def carried(scene: Scene) -> Scene:
    """The scene of the only camera of a rig; a scene with no rig, with a larger one, or of a recording stays as it is.

    The positions are then those of the camera, where it is with the body at a position of the room's, and the PDF says
    how the camera is turned there.

    Raises:
        InputError: the camera would be outside the room.
    """
    rig = scene.camera
    if not isinstance(rig, Rig) or len(rig.mounts) > 1 or scene.recorded is not None:
        return scene
    scene.check_inside(scene.room.grid())
    pdf = CarriedPdf.of(scene.pdf, rig, None)
    offsets = Offsets(scene.room, pdf.offsets, pdf.weight)
    if np.ptp(pdf.offsets, axis=0).any():
        pdf = CarriedPdf.of(scene.pdf, rig, offsets)
    room = Carried(offsets) if pdf.offsets.any() else scene.room
    return replace(scene, room=room, camera=rig.cameras[0], pdf=pdf)


@dataclass(frozen=True)
class CarriedPdf(OrientationPdf):
    """How the only camera of a rig is turned if its body is turned as another PDF says.

    Args:
        body: that PDF; the same everywhere.
        rig: of one camera.
        offsets: of the camera from the body's origin in each orientation, `(A, 3)`, world frame, metres.
        within: the offsets in their room, which then say how the camera is turned at a position; None where the camera
            is in the same place of the body for all orientations.
    """

    body: OrientationPdf = None  # type: ignore[assignment] # this and the next are always given by `of`
    rig: Rig = None  # type: ignore[assignment]
    offsets: FloatArray = None  # type: ignore[assignment]
    within: Offsets | None = None

    @classmethod
    def of(cls, body: OrientationPdf, rig: Rig, within: Offsets | None) -> "CarriedPdf":
        """The PDF of the camera of a rig on a body with the PDF `body`."""
        (yaw, pitch, roll), offsets = _turned(rig, body.yaw, body.pitch, np.asarray(body.roll))
        there = None if within is None else replace(within, each=offsets, probability=body.weight)
        name = f"{body.name}, carried by a rig"
        return cls(yaw, pitch, body.weight, name, None, None, roll, there, body, rig, offsets, there)

    @override
    def finer(self) -> OrientationPdf:
        return CarriedPdf.of(self.body.finer(), self.rig, self.within)

    @override
    def stratified(self, divisions: int, rng: np.random.Generator) -> OrientationPdf:
        return CarriedPdf.of(self.body.stratified(divisions, rng), self.rig, self.within)

    @override
    def draw(self, size: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
        return _turned(self.rig, *self.body.draw(size, rng))[0]


def _turned(
    rig: Rig, yaw: FloatArray, pitch: FloatArray, roll: FloatArray
) -> tuple[tuple[FloatArray, FloatArray, FloatArray], FloatArray]:
    """Yaw, pitch and roll of the camera, `(A,)` each, and its offset `(A, 3)`, for orientations of the body."""
    rows = rotation(yaw, pitch, roll)
    offsets, views = rig.views(np.hstack([rows[:, 2], rows[:, 0]]))
    axis, right = views[0, :, :3], views[0, :, 3:]
    angles = angles_of(np.stack([right, np.cross(axis, right), axis], axis=-2))
    return angles, np.round(offsets[0], SAME_PLACE_DECIMALS)
