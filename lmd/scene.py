"""A scene: everything that stays fixed while landmarks move."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from lmd.camera import Camera
from lmd.pdf import OrientationPdf, Orientations
from lmd.sight.criteria import Criteria
from lmd.space.space import Space


@dataclass(frozen=True)
class Scene:
    """Room, camera, orientation PDF and visibility model."""

    room: Space
    camera: Camera
    pdf: OrientationPdf
    visibility: Criteria

    @property
    def orientations(self) -> Orientations:
        """The distinct orientations of the PDF, as far as the visibility model tells them apart."""
        return self.pdf.by_axis_and_roll if self.visibility.needs_roll else self.pdf.by_axis

    @cached_property
    def sight(self) -> Any:
        """The visibility model compiled for the camera, a `lmd.sight.criteria.Sight`."""
        return self.visibility.sight(self.camera)
