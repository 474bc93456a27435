"""Fixed map: poses of tags that are known, with standard deviations."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from lmd.adjust.gauge import SIGMA_COLUMNS, rows_of
from lmd.core.checks import FloatArray, InputError, IntArray, check_fields, real
from lmd.core.files import read_text
from lmd.core.tables import read_table
from lmd.formats.tag_maps import FILE, read_deployment, read_map_covariance
from lmd.scene.deployment import Deployment, poses_of
from lmd.scene.labels import ID
from lmd.scene.tag import Tag

SAME_SIGMA = 1e-3  # largest relative difference between standard deviations in two files of one map
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
    covariance: FloatArray | None = None
    """`(6 K, 6 K)` covariance of the twists of all tags, each in its own frame; None if tags are independent."""
    note: str = ""
    """Note of the file."""

    def __post_init__(self) -> None:
        if (twice := self.ids[1:][np.diff(self.ids) == 0]).size:
            raise InputError(f"map has tag {twice[0]} twice.", "map")

    @cached_property
    def joint(self) -> FloatArray:
        """Covariance of the twists of all tags, `(6 K, 6 K)`, tag by tag."""
        return np.diag(self.sigmas.ravel() ** 2) if self.covariance is None else self.covariance

    @classmethod
    def read(cls, path: Any, tag: Tag, errors: MapErrors, **table: Any) -> "FixedMap":
        """Read a map in any format of `lmd.formats.tag_maps`; the standard deviations of a surveyed `map.csv` are kept.

        Args:
            path: file of the map.
            tag: family of the tags, and edge of the tags without an edge in the file.
            errors: standard deviations of tags for which the file has none.
            table: `axes` and `columns` of `lmd.formats.tag_maps.read_deployment`.

        Raises:
            InputError: the file cannot be read, or holds no tags of this family.
        """
        deployment = read_deployment(path, "map", tag.family, **table)
        order = np.argsort(deployment.ids, kind="stable")
        sigmas = np.repeat([[errors.turn, errors.place]], 3, axis=1) * np.ones((len(order), 1))
        edges = np.where(np.isfinite(deployment.edges), deployment.edges, np.nan if tag.is_point else tag.size)
        if np.isnan(edges).any():
            lacking = deployment.ids[np.isnan(edges)][0]
            message = (
                f"edge must be given, in metres: the map has no edge of tag {lacking}; it is that of the {tag.square}."
            )
            raise InputError(message, "edge")
        stated, covariance = _stated_sigmas(path), None
        if stated is not None:
            ids, values = stated
            rows = np.searchsorted(ids, deployment.ids[order])
            known = np.isfinite(values[rows])
            sigmas = np.where(known, np.maximum(values[rows], LEAST_SIGMA), sigmas)
            covariance = _stated_covariance(path, deployment.ids[order], sigmas)
        ids, poses = deployment.ids[order], poses_of(deployment)[order]
        return cls(ids, poses, edges[order], sigmas, covariance, deployment.note)


def surveyed_covariance(path: Any, deployment: Deployment) -> FloatArray | None:
    """Covariance of position and rotation of all tags of a surveyed map in the world frame, beside the other tags.

    Args:
        path: file of the map, as a survey writes it, with the covariance of all tags together beside it.
        deployment: K tags, in any order; tags that the file lacks have no error.

    Returns:
        m^2 and rad^2, tag by tag, `(6 K, 6 K)`; None for a file without standard deviations.

    Raises:
        InputError: a file cannot be read, the two are of different maps, or a tag has no standard deviation.
    """
    if (stated := _stated_sigmas(path)) is None:
        return None
    ids, values = stated
    there = np.isin(ids, deployment.ids)
    ids, sigmas = ids[there], np.maximum(values[there], LEAST_SIGMA)
    if (lacking := ids[~np.isfinite(sigmas).all(axis=1)]).size:
        raise InputError(f"map: tag {lacking[0]} in {str(path)!r} has no standard deviation: take it out.", "map")
    among = _stated_covariance(path, ids, sigmas)
    own = np.flatnonzero(np.isin(deployment.ids, ids))
    rows, chosen = rows_of(own), rows_of(np.searchsorted(ids, deployment.ids[own]))
    joint = np.zeros((6 * len(deployment), 6 * len(deployment)))
    whole = np.diag(sigmas.ravel() ** 2) if among is None else among
    joint[np.ix_(rows, rows)] = whole[np.ix_(chosen, chosen)]
    turned = np.zeros((len(deployment), 6, 6))
    turned[:, :3, 3:] = turned[:, 3:, :3] = poses_of(deployment)[:, :3, :3]
    turn = block_diag(*turned)
    return np.asarray(turn @ joint @ turn.T)


def information_of(covariance: FloatArray) -> FloatArray:
    """Inverse of a covariance of tags, `(6 n, 6 n)`; a motion of all tags, that has no variance, gets the least one."""
    return np.asarray(np.linalg.inv(covariance + LEAST_SIGMA**2 * np.eye(len(covariance))))


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


def _stated_covariance(path: Any, ids: IntArray, sigmas: FloatArray) -> FloatArray | None:
    """Covariance `(6 K, 6 K)` of the tags `ids` of a surveyed map, from the file beside it; None without this file.

    Args:
        path: file of the map.
        ids: ids, `(K,)`, ascending.
        sigmas: standard deviations in the map, `(K, 6)`, with which tags that the file lacks are independent.

    Raises:
        InputError: the file cannot be read, or is of another map.
    """
    beside = Path(str(path)).with_suffix(Path(FILE).suffix)
    if not beside.exists():
        return None
    among, covariance = read_map_covariance(beside, "map")
    _, of, there = np.intersect1d(ids, among, return_indices=True)
    own = np.sqrt(np.diag(covariance)).reshape(-1, 6)[there]
    if not np.allclose(np.maximum(own, LEAST_SIGMA), sigmas[of], rtol=SAME_SIGMA):
        text = f"map: {str(beside)!r} is of another map than {Path(str(path)).name!r}: take both from one survey"
        raise InputError(f"{text}, or remove it.", "map")
    result, rows, others = np.diag(sigmas.ravel() ** 2), rows_of(of), rows_of(there)
    result[np.ix_(rows, rows)] = covariance[np.ix_(others, others)]
    return result
