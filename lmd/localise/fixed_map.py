"""Fixed map: known poses of tags, with standard deviations."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from lmd.adjust.gauge import rows_of, world_from_twists
from lmd.adjust.prior import Hanging, Mounts, Prior
from lmd.adjust.tables import SIGMA_COLUMNS
from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.core.files import read_text
from lmd.core.tables import read_table
from lmd.formats.tag_maps import FILE, read_deployment, read_map_covariance
from lmd.scene.deployment import Deployment, poses_of
from lmd.scene.labels import ID
from lmd.scene.tag import Tag

SAME_SIGMA = 1e-3  # maximum relative difference between standard deviations of a tag in two files of one map
LEAST_SIGMA = 1e-5  # minimum standard deviation of a tag of the map, metres and rad


@dataclass(frozen=True)
class FixedMap:
    """K tags with known poses.

    Raises:
        InputError: an id occurs twice.
    """

    ids: IntArray
    """`(K,)` ids, ascending."""
    poses: FloatArray
    """`(K, 4, 4)` tag (x right, y up, z out) to map; NaN for tags that the map lacks, see `among`."""
    edges: FloatArray
    """`(K,)` edges of the black squares, metres."""
    sigmas: FloatArray
    """`(K, 6)` standard deviations of rotations about the axes of each tag, rad, and of shifts along them, metres."""
    covariance: FloatArray | None = None
    """Covariance of the twists of all tags, each in its own frame, `(6 K, 6 K)`; None if tags are independent."""
    note: str = ""
    """Note about the file, for the user."""

    def __post_init__(self) -> None:
        if (twice := self.ids[1:][np.diff(self.ids) == 0]).size:
            raise InputError(f"map has tag {twice[0]} twice.", "map")

    @cached_property
    def joint(self) -> FloatArray:
        """Covariance of the twists of all tags, `(6 K, 6 K)`, tag by tag."""
        return np.diag(self.sigmas.ravel() ** 2) if self.covariance is None else self.covariance

    @property
    def has(self) -> BoolArray:
        """Mask of the tags that the map has, `(K,)`."""
        return np.isfinite(self.poses[:, 0, 0])

    def among(self, ids: IntArray, edge: float) -> "FixedMap":
        """Map of the tags `ids` `(n,)`, ascending; tags that this map lacks have the edge `edge`, metres."""
        _, there, own = np.intersect1d(self.ids, ids, return_indices=True)
        poses, edges, sigmas = np.full((len(ids), 4, 4), np.nan), np.full(len(ids), edge), np.zeros((len(ids), 6))
        poses[own], edges[own], sigmas[own] = self.poses[there], self.edges[there], self.sigmas[there]
        return FixedMap(ids, poses, edges, sigmas, spread(self.joint, there, own, len(ids)))

    def prior(self, moved: BoolArray, mounts: Mounts | None = None) -> Prior:
        """Prior of all tags except those that were `moved`, mask `(K,)`, and of the mounts.

        A common motion of all tags has no variance in a surveyed map; it gets the minimum variance.
        """
        trusted, tags = self.has & ~moved, np.where(self.has[:, None, None], self.poses, np.eye(4))
        own, rows = np.flatnonzero(trusted), rows_of(np.flatnonzero(trusted))
        information = np.linalg.inv(self.joint[np.ix_(rows, rows)] + LEAST_SIGMA**2 * np.eye(len(rows)))
        joint = spread(np.asarray(information, dtype=np.float64), np.arange(len(own)), own, len(trusted))
        return Prior(tags, np.repeat(trusted[:, None], 6, axis=1).astype(float), None, mounts, joint=joint)

    @classmethod
    def read(cls, path: Any, tag: Tag, errors: Hanging, **table: Any) -> "FixedMap":
        """Read a map in any format of `lmd.formats.tag_maps`; the standard deviations of a surveyed `map.csv` are kept.

        Args:
            path: file of the map.
            tag: family of the tags, and edge of the tags without an edge in the file.
            errors: standard deviations of tags without standard deviations in the file.
            table: `axes` and `columns` of `lmd.formats.tag_maps.read_deployment`.

        Raises:
            InputError: the file cannot be read, or holds no tags of this family.
        """
        deployment = read_deployment(path, "map", tag.family, **table)
        order = np.argsort(deployment.ids, kind="stable")
        ids, poses, edges = deployment.ids[order], poses_of(deployment)[order], deployment.edges[order]
        edges = np.where(np.isfinite(edges), edges, np.nan if tag.is_point else tag.size)
        if np.isnan(edges).any():
            which = f"the map has no edge of tag {ids[np.isnan(edges)][0]}; measure its {tag.square}"
            raise InputError(f"edge must be given, in metres: {which}.", "edge")
        sigmas, covariance = np.tile(errors.deviations, (len(ids), 1)), None
        if (stated := _stated_sigmas(path)) is not None:
            values = stated[1][np.searchsorted(stated[0], ids)]
            sigmas = np.where(np.isfinite(values), np.maximum(values, LEAST_SIGMA), sigmas)
            covariance = _stated_covariance(path, ids, sigmas)
        return cls(ids, poses, edges, sigmas, covariance, deployment.note)


def spread(matrix: FloatArray, chosen: IntArray, places: IntArray, count: int) -> FloatArray:
    """Matrix of `count` tags, six rows for each, with the rows and columns of the tags `chosen` at `places` and 0
    elsewhere.
    """
    result, rows, own = np.zeros((6 * count, 6 * count)), rows_of(places), rows_of(chosen)
    result[np.ix_(rows, rows)] = matrix[np.ix_(own, own)]
    return result


def surveyed_covariance(path: Any, deployment: Deployment) -> FloatArray | None:
    """Joint covariance of position and rotation of all tags of a surveyed map, in the world frame.

    Args:
        path: file of the map, as a survey writes it; the file of the joint covariance is beside it.
        deployment: K tags, in any order; tags that the file lacks have no error.

    Returns:
        m^2 and rad^2, tag by tag, `(6 K, 6 K)`; None for a file without standard deviations.

    Raises:
        InputError: a file cannot be read, the two files are of different maps, or a tag has no standard deviation.
    """
    if (stated := _stated_sigmas(path)) is None:
        return None
    there = np.isin(stated[0], deployment.ids)
    ids, sigmas = stated[0][there], np.maximum(stated[1][there], LEAST_SIGMA)
    if (lacking := ids[~np.isfinite(sigmas).all(axis=1)]).size:
        raise InputError(f"map: tag {lacking[0]} in {str(path)!r} has no standard deviation: remove the tag.", "map")
    among, own = _stated_covariance(path, ids, sigmas), np.flatnonzero(np.isin(deployment.ids, ids))
    whole = np.diag(sigmas.ravel() ** 2) if among is None else among
    joint = spread(whole, np.searchsorted(ids, deployment.ids[own]), own, len(deployment))
    turn = block_diag(*world_from_twists(poses_of(deployment)))
    return np.asarray(turn @ joint @ turn.T)


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
        raise InputError(f"{path}: a standard deviation of a tag is not a number ({error}).", "map") from None
    if (values < 0.0).any() or np.isnan(values).any():
        raise InputError(f"{path}: the columns {SIGMA_COLUMNS[0]} ... {SIGMA_COLUMNS[-1]} must not be negative.", "map")
    order = np.argsort(ids, kind="stable")
    return ids[order], values[order]


def _stated_covariance(path: Any, ids: IntArray, sigmas: FloatArray) -> FloatArray | None:
    """Joint covariance `(6 K, 6 K)` of the tags `ids` of a surveyed map, from the file beside the map; None without the
    file.

    Args:
        path: file of the map.
        ids: ids, `(K,)`, ascending.
        sigmas: standard deviations in the map, `(K, 6)`, for tags that the file lacks, which are independent.

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
        text = f"map: {str(beside)!r} is not of the map {Path(str(path)).name!r}: use both files of one survey"
        raise InputError(f"{text}, or remove it.", "map")
    alone = np.where(np.isin(np.arange(len(ids)), of)[:, None], 0.0, sigmas**2)
    return np.diag(alone.ravel()) + spread(covariance, there, of, len(ids))
