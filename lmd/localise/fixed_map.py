"""Fixed map: poses of tags that are known, with standard deviations."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError, IntArray, check_fields, real
from lmd.core.files import read_text
from lmd.core.tables import read_table
from lmd.formats.tag_maps import read_deployment
from lmd.scene.labels import ID
from lmd.scene.tag import Tag
from lmd.survey.prior import poses_of
from lmd.survey.results import SIGMA_COLUMNS

LEAST_SIGMA = 1e-5  # least standard deviation of a tag of the map, metres and rad


@dataclass(frozen=True)
class MapErrors:
    """Standard deviations of the tags of a map that states none.

    Raises:
        InputError: a standard deviation is not positive.
    """

    place: float = 0.001
    """Position along each axis, metres."""
    turn: float = 0.003
    """Rotation about each axis, rad."""

    def __post_init__(self) -> None:
        check_fields(self, real, "place", "turn", above=0.0)


@dataclass(frozen=True)
class FixedMap:
    """K tags with known poses.

    Raises:
        InputError: an id occurs twice.
    """

    ids: IntArray
    """`(K,)` ids, ascending."""
    poses: FloatArray
    """`(K, 4, 4)` tag (x right, y up, z out) to map."""
    edges: FloatArray
    """`(K,)` edges of the black squares, metres."""
    sigmas: FloatArray
    """`(K, 6)` standard deviations of rotations about the axes of each tag, rad, and of shifts along them, metres."""
    note: str = ""
    """Note of the file."""

    def __post_init__(self) -> None:
        if (twice := self.ids[1:][np.diff(self.ids) == 0]).size:
            raise InputError(f"map has tag {twice[0]} twice.", "map")

    @classmethod
    def read(cls, path: Any, tag: Tag, errors: MapErrors, axes: Sequence[str] | None = None) -> "FixedMap":
        """Read a map in any format of `lmd.formats.tag_maps`; the standard deviations of a surveyed `map.csv` are kept.

        Args:
            path: file of the map.
            tag: family of the tags, and edge of the tags without an edge in the file.
            errors: standard deviations of tags for which the file has none.
            axes: see `lmd.formats.tag_maps.read_deployment`.

        Raises:
            InputError: the file cannot be read, or holds no tags of this family.
        """
        deployment = read_deployment(path, "map", tag.family, axes)
        order = np.argsort(deployment.ids, kind="stable")
        sigmas = np.repeat([[errors.turn, errors.place]], 3, axis=1) * np.ones((len(order), 1))
        edges = np.where(np.isfinite(deployment.edges), deployment.edges, np.nan if tag.is_point else tag.size)
        if np.isnan(edges).any():
            lacking = deployment.ids[np.isnan(edges)][0]
            raise InputError(f"edge must be given, in metres: the map has no edge of tag {lacking}.", "edge")
        stated = _stated_sigmas(path)
        if stated is not None:
            ids, values = stated
            rows = np.searchsorted(ids, deployment.ids[order])
            known = np.isfinite(values[rows])
            sigmas = np.where(known, np.maximum(values[rows], LEAST_SIGMA), sigmas)
        return cls(deployment.ids[order], poses_of(deployment)[order], edges[order], sigmas, deployment.note)


def _stated_sigmas(path: Any) -> tuple[IntArray, FloatArray] | None:
    """Ids `(K,)`, ascending, and standard deviations `(K, 6)`, NaN if unknown, of a surveyed map; None for others."""
    if not all(name in read_text(path, name="map").partition("\n")[0].split(",") for name in (ID, *SIGMA_COLUMNS)):
        return None
    table = read_table(path, name="map")
    filled = {name: [text or "inf" for text in table.texts[name]] for name in SIGMA_COLUMNS}
    try:
        values = np.array([[float(text) for text in filled[name]] for name in SIGMA_COLUMNS]).T
        ids = np.array([int(text) for text in table.texts[ID]])
    except ValueError as error:
        raise InputError(f"{path}: a standard deviation of a tag is no number ({error}).", "map") from None
    if (values < 0.0).any() or np.isnan(values).any():
        raise InputError(f"{path}: the columns {SIGMA_COLUMNS[0]} ... {SIGMA_COLUMNS[-1]} must not be negative.", "map")
    order = np.argsort(ids, kind="stable")
    return ids[order], values[order]
