"""Scenes: everything that is constant while landmarks are optimised."""

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
from lmd.space.crowd import CrowdStates
from lmd.space.space import Space

if TYPE_CHECKING:
    from lmd.scene.criteria import Criteria
    from lmd.scene.recorded_poses import RecordedPoses

PROBABILITY_BYTES = 24  # memory per position and orientation: probability, index and quantised probability
SAMPLED_POSITIONS = 512  # number of random positions of a rig that are checked


@dataclass(frozen=True)
class Scene:
    """Room, camera, orientation PDF, visibility model and tag.

    Args:
        room: surfaces for landmarks, and positions of the camera.
        camera: single camera, or a `Rig`; `room` and `pdf` give positions and orientations of the camera or of the
            rig's body.
        pdf: orientation PDF.
        visibility: criteria for the coverage of a landmark.
        tag: tag at each landmark; by default the tag of the visibility model, or a point.
        recorded: recording from which `room` and `pdf` are derived, with the poses that are held out for validation;
            None without a recording.
        edges: edge length of each landmark in the order of the deployment, or one length for all, metres, see `sized`;
            None for the edge length of `tag`.
        crowd: states of people and other robots that hide landmarks; None without a crowd.

    Raises:
        InputError: the visibility model has another tag, it has `covered` but no `sight`, or a scene with a rig has a
            crowd.
    """

    room: Space
    camera: Camera | Rig
    pdf: OrientationPdf
    visibility: "Criteria"
    tag: Tag = None  # type: ignore[assignment] # always a tag once made
    recorded: "RecordedPoses | None" = None
    edges: tuple[float, ...] | None = None
    crowd: CrowdStates | None = None

    def __post_init__(self) -> None:
        if hasattr(self.visibility, "covered") and not hasattr(self.visibility, "sight"):
            name = type(self.visibility).__name__
            raise InputError(
                f"{name} has `covered` and no `sight`: derive it from lmd.scene.criteria.Covering.", "visibility"
            )
        seen = getattr(self.visibility, "tag", None)
        object.__setattr__(self, "tag", (seen or Tag()) if self.tag is None else self.tag)
        if seen is not None and seen != self.tag:
            raise InputError(f"tag is {self.tag}, but visibility is for {seen}.", "tag")
        if self.rig is not None:
            self.check_no_crowd(f"a rig of {len(self.rig.mounts)} cameras")

    def sized(self, edges: FloatArray) -> "Scene":
        """Scene for deployments of K landmarks with given edge lengths.

        The scene itself is returned if all entries of `edges` are NaN, or if landmarks are points.

        Args:
            edges: edge lengths of the black squares, metres, `(K,)`; NaN for the edge length of `tag`.
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
        """Largest edge length of a landmark, metres; 0 for points."""
        return 0.0 if self.tag.is_point else max(self.edges or (self.tag.size,))

    @property
    def has_several_sizes(self) -> bool:
        """True if the edge lengths of landmarks differ."""
        return self.edges is not None and len(self.edges) > 1

    def check_one_size(self, what: str) -> None:
        """Raise `InputError` if tags have several sizes; `what` is the subject of the error message."""
        if self.edges is not None and self.has_several_sizes:
            sizes = ", ".join(f"{edge:g}" for edge in sorted(set(self.edges)))
            raise InputError(f"{what} works with tags of one size, not with edges of {sizes} m.")

    def check_count(self, count: int) -> None:
        """Raise `InputError` if `edges` has one value per landmark, but not `count` values."""
        if self.edges is not None and len(self.edges) not in (1, count):
            raise InputError(f"{count} landmarks need one edge each, but edges has {len(self.edges)} values.")

    @cached_property
    def footprints(self) -> Footprints:
        """Footprints of the tags: the squares that their papers cover on the surfaces."""
        return Footprints(self.room, self.tag)

    @property
    def spacing(self) -> float:
        """Least distance between neighbouring landmarks at which they neither hide nor overlap each other, metres."""
        return max(self.visibility.spacing, self.footprints.edge)

    @property
    def rig(self) -> Rig | None:
        """The rig; None for a single camera."""
        return rig_of(self.camera)

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The single camera, or the C cameras of the rig."""
        return self.camera.cameras

    @property
    def extrinsics(self) -> FloatArray:
        """Poses of the cameras in the frame of the rig's body, `(C, 4, 4)`; the identity for a single camera."""
        return self.camera.extrinsics

    def single_camera(self, what: str) -> Camera:
        """Return the single camera, for functions that do not support rigs.

        Args:
            what: subject of the error message.

        Raises:
            InputError: the scene has a rig.
        """
        if self.rig is not None:
            raise InputError(f"{what} works with a single camera, not with a rig of {len(self.rig.mounts)}.")
        return self.cameras[0]

    def check_no_crowd(self, what: str) -> None:
        """Raise `InputError` if the scene has a crowd; `what` is the subject of the error message."""
        if self.crowd is not None:
            raise InputError(f"crowd: {what} works only without people in the way.", "crowd")

    def in_state(self, state: int) -> "Scene":
        """Scene with only the crowd state of index `state`; the scene itself without a crowd."""
        return self if self.crowd is None else replace(self, crowd=self.crowd.only(state))

    def stations(self, axes: FloatArray) -> Iterator[Station]:
        """Yield the distinct offsets of each camera from the body's origin, for given orientations of the body.

        A `Station` is one such offset together with its orientations. A single camera has one station, with offset 0.

        Args:
            axes: orientations of the single camera or of the rig's body, two unit vectors each, world frame, `(A, 6)`.
                The first is the optical axis (for a body, the x axis), the second the direction to the right.
        """
        if self.rig is not None:
            yield from self.rig.stations(axes)
        else:
            yield Station(self.cameras[0], np.zeros(3), np.arange(len(axes)), axes)

    def check_inside(self, positions: FloatArray) -> None:
        """Raise `InputError` if a possible pose of the body would put a camera of the rig outside the room.

        The function checks `positions` `(P, 3)` of the body and `SAMPLED_POSITIONS` random positions, each with all
        orientations that have a positive probability at that position.
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
        """Distinct orientations of the PDF.

        Orientations that differ only in roll are merged if roll has no effect.
        """
        by_rig = self.rig is not None and self.rig.needs_roll
        return self.pdf.by_axis_and_roll if by_rig or self.visibility.needs_roll else self.pdf.by_axis

    def probability(self, positions: FloatArray) -> FloatArray:
        """Probability of each distinct orientation at each position, `(Q, D)`: a row for each of the Q positions.

        The columns are those of `orientations`. The result has a single row, `(1, D)`, if the PDF does not depend on
        the position. `positions` has the shape `(Q, 3)`, metres.
        """
        axes, index_of, _ = self.orientations
        check_views(PROBABILITY_BYTES, 1 if self.pdf.by_position is None else len(positions), len(index_of))
        rows = self.pdf.at(positions)
        index = len(axes) * np.arange(len(rows))[:, None] + index_of
        total = np.bincount(index.reshape(-1), weights=rows.reshape(-1), minlength=len(rows) * len(axes))
        return np.asarray(total.reshape(len(rows), len(axes)), dtype=np.float64)

    @property
    def is_compiled(self) -> bool:
        """True if the visibility model has a compiled model of sight, a `SightModel`."""
        return self.visibility.sight(self.cameras[0]) is not None

    def check_compiled(self, what: str) -> None:
        """Raise `InputError` if the visibility model has no compiled model of sight, a `SightModel`.

        `what` is the subject of the error message.
        """
        if not self.is_compiled:
            name = type(self.visibility).__name__
            raise InputError(
                f"{what} needs a compiled visibility model, but {name} has no `sight`; see docs/extend.md, "
                '"Compile a criterion".'
            )

    @cached_property
    def sight(self) -> Any:
        """Visibility model compiled for the single camera, a `SightModel`, see `lmd.scene.criteria.Criteria.sight`."""
        return self.visibility.sight(self.single_camera("this"))
