"""A scene: everything that stays fixed while landmarks move."""

from dataclasses import dataclass

from lmd.camera import Camera
from lmd.pdf import OrientationPdf
from lmd.sight.visibility import Limits, Visibility
from lmd.space.cuboid import Room


@dataclass(frozen=True)
class Scene:
    """Room, camera, orientation PDF and visibility model."""

    room: Room
    camera: Camera
    pdf: OrientationPdf
    visibility: Visibility

    @property
    def limits(self) -> Limits:
        """Depth bounds of the coverage criteria."""
        return Limits.of(self.camera, self.visibility)
