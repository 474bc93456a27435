"""A scene: everything that stays fixed while landmarks move."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from lmd.camera import Camera
from lmd.checks import InputError
from lmd.pdf import OrientationPdf, Orientations
from lmd.plates import Plates
from lmd.space.space import Space
from lmd.tag import Tag

if TYPE_CHECKING:
    from lmd.sight.criteria import Criteria


@dataclass(frozen=True)
class Scene:
    """Room, camera, orientation PDF, visibility model and tag.

    Args:
        room: where landmarks and camera are.
        camera: what looks for them.
        pdf: where it looks.
        visibility: when it sees one.
        tag: what hangs at each landmark; by default what the visibility model is about, or a point.

    Raises:
        InputError: the visibility model is about another tag.
    """

    room: Space
    camera: Camera
    pdf: OrientationPdf
    visibility: "Criteria"
    tag: Tag = None  # type: ignore[assignment] # always a tag once made

    def __post_init__(self) -> None:
        seen = getattr(self.visibility, "tag", None)
        object.__setattr__(self, "tag", self.tag or seen or Tag())
        if seen is not None and seen != self.tag:
            raise InputError(f"tag is {self.tag}, but visibility is about {seen}.", "tag")

    @cached_property
    def plates(self) -> Plates:
        """The papers of the tags, and where they may hang."""
        return Plates(self.room, 0.0 if self.tag.is_point else self.tag.paper_edge)

    @property
    def spacing(self) -> float:
        """How far apart neighbouring landmarks had better be, metres."""
        return max(self.visibility.spacing, self.plates.edge)

    @property
    def orientations(self) -> Orientations:
        """The distinct orientations of the PDF, as far as the visibility model tells them apart."""
        return self.pdf.by_axis_and_roll if self.visibility.needs_roll else self.pdf.by_axis

    @cached_property
    def sight(self) -> Any:
        """The visibility model compiled for the camera, a `lmd.sight.criteria.Sight`."""
        return self.visibility.sight(self.camera)
