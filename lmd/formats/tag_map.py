"""Tag map of a deployment, from which all formats are written."""

import warnings
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from lmd.core.checks import FloatArray, IntArray
from lmd.formats.placed_tag import HALF_TURN
from lmd.geometry.camera import MM_PER_M
from lmd.geometry.squares import corners
from lmd.scene.deployment import Deployment
from lmd.scene.families import FAMILIES
from lmd.scene.tag import Tag
from lmd.space.fixture import Fixture
from lmd.space.space import Space
from lmd.space.surface import FLAT

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

QUATERNION = ("qw", "qx", "qy", "qz")
# Number of decimals in files: picometres, as further digits are rounding errors.
DECIMALS = 12


@dataclass(frozen=True)
class TagMap:
    """Map of K tags in a room; world frame, metres.

    Args:
        room: room in which the tags hang.
        tag: family and size of the tags.
        deployment: poses of the tags; ids are the numbers in the family.

    Raises:
        InputError: the tag has no size, or the family lacks an id.
    """

    room: Space
    tag: Tag
    deployment: Deployment

    def __post_init__(self) -> None:
        self.tag.check_edge()
        self.tag.check_ids(self.deployment.ids)

    @property
    def ids(self) -> list[int]:
        """Number (id) of each tag in its family."""
        return [int(number) for number in self.deployment.ids]

    @cached_property
    def surfaces(self) -> IntArray:
        """Index of the surface on which each tag is mounted, `(K,)`; -1 for tags that are on no surface.

        A tag that was measured slightly in front of a surface is mounted on that surface.
        """
        return self.deployment.belonging(self.room)

    @cached_property
    def fixtures(self) -> tuple[Fixture, ...]:
        """Fixtures of the room: doors, windows, furniture and other objects."""
        return tuple(self.room.fixtures())

    @cached_property
    def at(self) -> FloatArray:
        """Distance of each tag from the left and the lower edge of its surface, `(K, 2)`, metres; NaN for tags on no
        surface.

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
        """Indices of the surfaces with tags, in the order of a walk through the room; -1, which stands for tags on no
        surface, is last.

        Walls are ordered from left to right around the middle of the room; horizontal surfaces follow.
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
        """Indices of the tags in the order of hanging, `(K,)`: along `route`, and on a surface from left to right, then
        upwards.
        """
        rank = np.array([self.route.index(surface) for surface in self.surfaces.tolist()])
        left, below = np.round(self.at, DECIMALS).T
        return np.asarray(np.lexsort((self.deployment.ids, below, left, rank)))

    @cached_property
    def tags_by_surface(self) -> dict[int, IntArray]:
        """Tags on each surface of `route`, keyed by the index of the surface.

        A tag is given by its rank in the order of hanging, that is, by its index in the array `order`.
        """
        return {index: np.flatnonzero(self.surfaces[self.order] == index) for index in self.route}

    @cached_property
    def names(self) -> list[str]:
        """Name of each surface of the room, as written in files and shown in the planner."""
        return [surface.name for surface in self.room.surfaces()]

    def place_of(self, k: int) -> str:
        """Name of the surface that carries tag k; `free in the room` for a tag on no surface."""
        surface = self.surfaces[k]
        return "free in the room" if surface < 0 else self.names[surface]

    @cached_property
    def sizes(self) -> FloatArray:
        """Edge length of each tag, metres, `(K,)`: that of the deployment, or else that of `tag`."""
        return self.deployment.edges_of(self.tag)

    @property
    def papers(self) -> FloatArray:
        """Edge length of each tag including its white margin (its paper), metres, `(K,)`."""
        return self.tag.paper_share * self.sizes

    @cached_property
    def by_size(self) -> list[tuple[Tag, IntArray]]:
        """Pairs, the smallest size first: a tag of this size, and indices of the tags with this size, as in `order`."""
        own = self.sizes[self.order]
        return [(self.tag.of_size(edge), self.order[own == edge]) for edge in np.unique(own).tolist()]

    @property
    def edges_in_words(self) -> str:
        """Edge lengths of the tags, with the square to which they refer, in words: `80, 100 mm (black square)`."""
        return f"{', '.join(f'{MM_PER_M * tag.size:.4g}' for tag, _ in self.by_size)} mm ({self.tag.square})"

    @property
    def positions(self) -> FloatArray:
        """Centres of the tags, world frame, metres, `(K, 3)`, rounded for files."""
        return rounded_values(self.deployment.places)

    @cached_property
    def turns(self) -> "Rotation":
        """K rotations, from the frame of each tag (x right, y up, z towards the viewer) to the world."""
        from scipy.spatial.transform import Rotation

        up, normal = self.deployment.ups, self.deployment.normals
        return Rotation.from_matrix(np.stack([np.cross(up, normal), up, normal], axis=-1))

    @property
    def roll_pitch_yaw(self) -> FloatArray:
        """Rotations of the tags as roll, pitch and yaw of ROS's `setRPY`, `(K, 3)`, rad, for programs that use OpenCV.

        A tag's frame has x right, y up and z out. Up is as in OpenCV's pictures of tags, which show AprilTags upside
        down.
        """
        from scipy.spatial.transform import Rotation

        half = FAMILIES[self.tag.family].apriltag is not None
        turns = self.turns * Rotation.from_matrix(HALF_TURN) if half else self.turns
        with warnings.catch_warnings():  # if yaw and roll have a common axis, only their sum is determined
            warnings.filterwarnings("ignore", message="Gimbal lock")
            return rounded_values(turns.as_euler("xyz"))

    @property
    def quaternions(self) -> FloatArray:
        """Rotations `turns` as quaternions w, x, y, z with w >= 0, `(K, 4)`."""
        return rounded_values(self.turns.as_quat(canonical=True, scalar_first=True))

    @property
    def corners(self) -> FloatArray:
        """Corners of the black squares, world frame, metres, `(K, 4, 3)`: top left, top right, bottom right, bottom
        left as seen from the front.
        """
        return rounded_values(corners(self.deployment.places, self.deployment.normals, self.deployment.ups, self.sizes))


def rounded_values(values: FloatArray) -> FloatArray:
    """Values rounded to `DECIMALS` decimals for files; -0 becomes 0."""
    return np.asarray(np.round(values, DECIMALS) + 0.0)


def axes(values: FloatArray) -> dict[str, float]:
    """Mapping {"x": ..., "y": ..., "z": ...} of values `(3,)`."""
    return dict(zip("xyz", values.tolist(), strict=True))


def write_yaml(path: Path, keys: dict[str, Any], *header: str) -> None:
    """Write YAML: a comment as header, then the keys in their order; innermost lists and mappings are on one
    line each.
    """
    text = yaml.safe_dump(keys, sort_keys=False, default_flow_style=None, width=1000)
    path.write_text("".join(f"{line}\n" for line in header) + text, encoding="utf-8")
