"""A scene: everything that stays fixed while landmarks move."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.core.memory import check_views
from lmd.geometry.camera import Camera
from lmd.scene.footprints import Footprints
from lmd.scene.pdf import OrientationPdf, Orientations
from lmd.scene.rig import Rig, Station, rig_of
from lmd.scene.tag import Tag
from lmd.space.space import Space

if TYPE_CHECKING:
    from lmd.scene.criteria import Criteria
    from lmd.scene.recorded_poses import RecordedPoses

PROBABILITY_BYTES = 24  # of an orientation at a position: its probability, which one it is, and its whole units
SAMPLED_POSITIONS = 512  # random positions of a rig that are looked at


@dataclass(frozen=True)
class Scene:
    """Room, camera, orientation PDF, visibility model and tag.

    Args:
        room: where landmarks and camera are.
        camera: what looks for them; a `Rig` for several cameras on one body, whose poses then are the room's and the
            PDF's.
        pdf: where it looks.
        visibility: when it sees one.
        tag: what hangs at each landmark; by default what the visibility model is about, or a point.
        recorded: what room and PDF were recorded by, with the poses kept back to validate on; None if they were not.
        edges: of each landmark of a deployment, by its index, metres, or one that all have, see `sized`; None where
            they have the tag's.

    Raises:
        InputError: the visibility model is about another tag.
    """

    room: Space
    camera: Camera | Rig
    pdf: OrientationPdf
    visibility: "Criteria"
    tag: Tag = None  # type: ignore[assignment] # always a tag once made
    recorded: "RecordedPoses | None" = None
    edges: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if hasattr(self.visibility, "covered") and not hasattr(self.visibility, "sight"):
            name = type(self.visibility).__name__
            raise InputError(
                f"{name} has `covered` and no `sight`: derive it from lmd.scene.criteria.Covering.", "visibility"
            )
        seen = getattr(self.visibility, "tag", None)
        object.__setattr__(self, "tag", self.tag or seen or Tag())
        if seen is not None and seen != self.tag:
            raise InputError(f"tag is {self.tag}, but visibility is about {seen}.", "tag")

    def sized(self, edges: FloatArray) -> "Scene":
        """The scene for landmarks with edges `(K,)`, metres, NaN for that of the tag, in every deployment.

        Itself if all are NaN, and for points, which have no size.
        """
        if self.tag.is_point or np.isnan(edges).all():
            return self
        each = tuple(self.tag.filled(edges).tolist())
        each = each if len(set(each)) > 1 else each[:1]
        if each == (self.edges or (self.tag.size,)):
            return self
        visibility = self.visibility
        if hasattr(visibility, "sized"):
            visibility = visibility.sized(each)
        return replace(self, visibility=visibility, edges=each)

    @property
    def largest_edge(self) -> float:
        """Of all landmarks, metres; 0 where they are points."""
        return 0.0 if self.tag.is_point else max(self.edges or (self.tag.size,))

    @property
    def has_several_sizes(self) -> bool:
        """True if the edges of landmarks differ."""
        return self.edges is not None and len(self.edges) > 1

    def check_one_size(self, what: str) -> None:
        """Raise `InputError` if there are tags of several sizes, of which `what`, the subject, does not know."""
        if self.edges is not None and self.has_several_sizes:
            sizes = ", ".join(f"{edge:g}" for edge in sorted(set(self.edges)))
            raise InputError(f"{what} works with tags of one size, not with edges of {sizes} m.")

    def check_count(self, count: int) -> None:
        """Raise `InputError` if the edges are those of another number of landmarks."""
        if self.edges is not None and len(self.edges) not in (1, count):
            raise InputError(f"of {count} landmarks the sizes are not known: there are {len(self.edges)} edges.")

    @cached_property
    def footprints(self) -> Footprints:
        """The papers of the tags, and where they may hang."""
        return Footprints(self.room, self.tag)

    @property
    def spacing(self) -> float:
        """Distance at which neighbouring landmarks neither hide each other nor overlap, metres."""
        return max(self.visibility.spacing, self.footprints.edge)

    @property
    def rig(self) -> Rig | None:
        """The rig; None for a single camera."""
        return rig_of(self.camera)

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The camera, or those of the rig."""
        return self.camera.cameras

    @property
    def extrinsics(self) -> FloatArray:
        """Poses of the cameras in the frame that moves, `(C, 4, 4)`: that of the rig's body, or of the only camera."""
        return self.camera.extrinsics

    def single_camera(self, what: str) -> Camera:
        """The only camera, for what does not know of rigs.

        Args:
            what: needs it, the subject of the sentence.

        Raises:
            InputError: there is a rig.
        """
        if self.rig is not None:
            raise InputError(f"{what} works with a single camera, not with a rig of {len(self.rig.mounts)}.")
        return self.cameras[0]

    def stations(self, axes: FloatArray) -> Iterator[Station]:
        """Places of the cameras for orientations of the camera, or of the body of a rig, `(A, 6)`."""
        if self.rig is not None:
            yield from self.rig.stations(axes)
        else:
            yield Station(self.cameras[0], np.zeros(3), np.arange(len(axes)), axes)

    def check_inside(self, positions: FloatArray) -> None:
        """Raise `InputError` if a camera of a rig is outside the room with its body at a position where it may be.

        Asked are `positions` `(P, 3)` and random ones, each with the orientations that occur there.
        """
        if self.rig is None:
            return
        positions = np.vstack([positions, self.room.sample(SAMPLED_POSITIONS, np.random.default_rng(0))])
        offsets = self.rig.views(self.orientations.axes)[0]
        occurs, kind_of = np.unique(self.probability(positions) > 0.0, axis=0, return_inverse=True)
        places = [np.unique(offsets[:, turns].reshape(-1, 3), axis=0) for turns in occurs]
        for position, kind in zip(positions, np.broadcast_to(kind_of.reshape(-1), len(positions)), strict=True):
            cameras = position + places[kind]
            outside = ~self.room.contains(cameras)
            if outside.any():
                place, body = (
                    ", ".join(f"{value:.3g}" for value in at) for at in (cameras[np.argmax(outside)], position)
                )
                raise InputError(
                    f"rig has a camera at [{place}], outside the room, when the body is at [{body}].", "rig"
                )

    @property
    def orientations(self) -> Orientations:
        """The distinct orientations of the PDF, as far as the visibility model and a rig tell them apart."""
        by_rig = self.rig is not None and self.rig.needs_roll
        return self.pdf.by_axis_and_roll if by_rig or self.visibility.needs_roll else self.pdf.by_axis

    def probability(self, positions: FloatArray) -> FloatArray:
        """The probability of each orientation at positions `(Q, 3)`: `(Q, D)`, or `(1, D)` if they share it."""
        axes, index_of, _ = self.orientations
        check_views(PROBABILITY_BYTES, 1 if self.pdf.by_position is None else len(positions), len(index_of))
        rows = self.pdf.at(positions)
        index = len(axes) * np.arange(len(rows))[:, None] + index_of
        total = np.bincount(index.reshape(-1), weights=rows.reshape(-1), minlength=len(rows) * len(axes))
        return np.asarray(total.reshape(len(rows), len(axes)), dtype=np.float64)

    @property
    def is_compiled(self) -> bool:
        """True if the visibility model has a compiled half."""
        return self.visibility.sight(self.cameras[0]) is not None

    def check_compiled(self, what: str) -> None:
        """Raise `InputError` if the visibility model has no compiled half, which `what`, the subject, needs."""
        if not self.is_compiled:
            name = type(self.visibility).__name__
            raise InputError(
                f"{what} needs the compiled half of {name}, which has none: give it `sight`, see CONTRIBUTING.md, "
                '"Compile a criterion".'
            )

    @cached_property
    def sight(self) -> Any:
        """The visibility model compiled for the single camera, see `lmd.scene.criteria.Criteria.sight`."""
        return self.visibility.sight(self.single_camera("this"))
