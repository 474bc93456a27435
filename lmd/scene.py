"""A scene: everything that stays fixed while landmarks move."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from lmd.camera import Camera
from lmd.pdf import OrientationPdf
from lmd.space.space import Space

if TYPE_CHECKING:
    from lmd.sight.criteria import Criteria


@dataclass(frozen=True)
class Scene:
    """Room, camera, orientation PDF and visibility model."""

    room: Space
    camera: Camera
    pdf: OrientationPdf
    visibility: "Criteria"

    @cached_property
    def sight(self) -> Any:
        """The visibility model compiled for the camera, a `lmd.sight.criteria.Sight`."""
        return self.visibility.sight(self.camera)
