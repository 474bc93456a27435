"""Poses of the tags of a deployment, from which every format is written."""

import warnings
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from lmd.core.checks import FloatArray, IntArray
from lmd.formats.tag_map_readers import HALF_TURN
from lmd.geometry.camera import MM_PER_M
from lmd.geometry.squares import corners
from lmd.scene.deployment import Deployment
from lmd.scene.families import FAMILIES
from lmd.scene.tag import Tag
from lmd.space.fixture import Fixture
from lmd.space.names import name_for_people
from lmd.space.space import Space
from lmd.space.surface import FLAT

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

QUATERNION = ("qw", "qx", "qy", "qz")
# Written are picometres: what is less is rounding.
DECIMALS = 12


@dataclass(frozen=True)
class TagMap:
    """K tags in a room. World frame, metres.

    Args:
        room: where they hang.
        tag: their family and size.
        deployment: their places; the ids are their numbers in the family.

    Raises:
        InputError: the tag is a point, or the family lacks an id.
    """

    room: Space
    tag: Tag
    deployment: Deployment

    def __post_init__(self) -> None:
        self.tag.check_edge()
        self.tag.check_ids(self.deployment.ids)

    @property
    def ids(self) -> list[int]:
        """Number of each in the family."""
        return [int(number) for number in self.deployment.ids]

    @cached_property
    def surfaces(self) -> IntArray:
        """The surface of the room that each is mounted on, `(K,)`; -1 for one that stands free in the room.

        A tag that was measured a little before a surface is mounted on it.
        """
        return self.deployment.belonging(self.room)

    @cached_property
    def fixtures(self) -> tuple[Fixture, ...]:
        """Fixtures of the room: doors, windows, furniture and others."""
        return tuple(self.room.fixtures())

    @cached_property
    def at(self) -> FloatArray:
        """Distance of each tag from the left and the lower edge of its surface, `(K, 2)`, metres; NaN for free tags.

        Left is as seen by a viewer who faces the surface.
        """
        at = np.full((len(self.ids), 2), np.nan)
        for index, surface in enumerate(self.room.surfaces()):
            own = self.surfaces == index
            at[own] = surface.from_left_and_below(
                np.stack(surface.coordinates(self.deployment.positions[own]), axis=-1)
            )
        return at

    @cached_property
    def route(self) -> list[int]:
        """The surfaces with tags in the order in which one comes to them, -1 for what is free in the room at the end.

        That is from left to right around the middle of the room, then what lies flat.
        """
        surfaces, (low, high) = self.room.surfaces(), self.room.bounds()
        middles = np.array([surface.point(*np.divide(surface.extent, 2.0)) for surface in surfaces])
        x, y = (middles - (low + high) / 2.0)[:, :2].T
        flat = np.array([abs(surface.normal[2]) > FLAT for surface in surfaces])
        angle = np.arctan2(y, x)
        turned = np.round(angle[np.argmin(flat)] - angle, 9) % (2.0 * np.pi)
        order = np.lexsort((np.where(flat, 0.0, turned), flat))
        return [index for index in [*order.tolist(), -1] if (self.surfaces == index).any()]

    @cached_property
    def order(self) -> IntArray:
        """The tags in the order of hanging, `(K,)`: along `route`, on a surface from the left and then from below."""
        rank = np.array([self.route.index(surface) for surface in self.surfaces.tolist()])
        left, below = np.round(self.at, DECIMALS).T
        return np.asarray(np.lexsort((self.deployment.ids, below, left, rank)))

    @cached_property
    def tags_by_surface(self) -> dict[int, IntArray]:
        """Of each surface of `route` the places of its tags in `order`, counted from 0."""
        return {index: np.flatnonzero(self.surfaces[self.order] == index) for index in self.route}

    @cached_property
    def names(self) -> list[str]:
        """Name of each surface of the room for people."""
        return [name_for_people(surface, self.fixtures) for surface in self.room.surfaces()]

    def place_of(self, k: int) -> str:
        """Name of the surface of tag k for people."""
        surface = self.surfaces[k]
        return "free in the room" if surface < 0 else self.names[surface]

    @cached_property
    def sizes(self) -> FloatArray:
        """The edge of each, `(K,)`: its own, or that of the tag."""
        return self.deployment.edges_of(self.tag)

    @property
    def papers(self) -> FloatArray:
        """The edge of the paper of each, `(K,)`."""
        return self.tag.paper_share * self.sizes

    @cached_property
    def by_size(self) -> list[tuple[Tag, IntArray]]:
        """The tag of each size, the smallest first, and those that have it in the order of hanging."""
        own = self.sizes[self.order]
        return [(self.tag.of_size(edge), self.order[own == edge]) for edge in np.unique(own).tolist()]

    @property
    def edges_in_words(self) -> str:
        """The edges that occur, mm."""
        return f"{', '.join(f'{MM_PER_M * tag.size:.4g}' for tag, _ in self.by_size)} mm"

    @property
    def positions(self) -> FloatArray:
        """Their centres, `(K, 3)`."""
        return rounded_values(self.deployment.places)

    @cached_property
    def turns(self) -> "Rotation":
        """Rotation from the frame of each tag to the world: x to its right, y up, z out of it towards the viewer."""
        from scipy.spatial.transform import Rotation

        up, normal = self.deployment.ups, self.deployment.normals
        return Rotation.from_matrix(np.stack([np.cross(up, normal), up, normal], axis=-1))

    @property
    def roll_pitch_yaw(self) -> FloatArray:
        """`turns` as ROS's `setRPY` takes them, `(K, 3)`, rad, with the up that OpenCV gives to a picture."""
        from scipy.spatial.transform import Rotation

        half = FAMILIES[self.tag.family].apriltag is not None
        turns = self.turns * Rotation.from_matrix(HALF_TURN) if half else self.turns
        with warnings.catch_warnings():  # where yaw and roll are about one axis, any split of their sum will do
            warnings.filterwarnings("ignore", message="Gimbal lock")
            return rounded_values(turns.as_euler("xyz"))

    @property
    def quaternions(self) -> FloatArray:
        """`turns` as w, x, y, z with w >= 0, `(K, 4)`."""
        return rounded_values(self.turns.as_quat(canonical=True, scalar_first=True))

    @property
    def corners(self) -> FloatArray:
        """Of the black squares, top-left, top-right, bottom-right, bottom-left seen from the front, `(K, 4, 3)`."""
        return rounded_values(corners(self.deployment.places, self.deployment.normals, self.deployment.ups, self.sizes))


def rounded_values(values: FloatArray) -> FloatArray:
    """Values as files hold them: without what is less than any of them means, and without -0."""
    return np.asarray(np.round(values, DECIMALS) + 0.0)


def axes(values: FloatArray) -> dict[str, float]:
    """`(3,)` as {"x": ..., "y": ..., "z": ...}."""
    return dict(zip("xyz", values.tolist(), strict=True))


def write_yaml(path: Path, keys: dict[str, Any], *header: str) -> None:
    """Write keys in their order, innermost lists and mappings on one line, below the lines of a header."""
    text = yaml.safe_dump(keys, sort_keys=False, default_flow_style=None, width=1000)
    path.write_text("".join(f"{line}\n" for line in header) + text, encoding="utf-8")
