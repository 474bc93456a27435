"""Fixed map: known poses of tags, with standard deviations."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from lmd.adjust.gauge import rows_of, world_from_twists
from lmd.adjust.prior import Hanging, Mounts, Prior
from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.formats.tag_maps import FILE, read_deployment, read_map_covariance
from lmd.scene.deployment import Deployment, poses_of
from lmd.scene.tag import Tag

LEAST_SIGMA = 1e-5  # minimum standard deviation of a tag of the map, metres and rad


@dataclass(frozen=True)
class FixedMap:
    """K tags with known poses."""

    ids: IntArray
    """`(K,)` ids, ascending."""
    poses: FloatArray
    """`(K, 4, 4)` tag (x right, y up, z out) to map; NaN for tags that the map lacks, see `among`."""
    edges: FloatArray
    """`(K,)` edge lengths of the tags' black squares, metres."""
    sigmas: FloatArray
    """`(K, 6)` standard deviations of rotations about the axes of each tag, rad, and of shifts along them, metres."""
    covariance: FloatArray | None = None
    """Covariance of the twists of all tags, each in its own frame, `(6 K, 6 K)`; None if tags are independent."""
    note: str = ""
    """Note about the file, for the user."""

    @cached_property
    def joint(self) -> FloatArray:
        """Covariance of the twists of all tags, with six rows for each tag, `(6 K, 6 K)`; block diagonal if tags are
        independent.
        """
        return np.diag(self.sigmas.ravel() ** 2) if self.covariance is None else self.covariance

    @property
    def has(self) -> BoolArray:
        """Mask of the tags that have a pose in the map, `(K,)`."""
        return np.isfinite(self.poses[:, 0, 0])

    def among(self, ids: IntArray, edge: float) -> "FixedMap":
        """Map of the tags `ids` `(n,)`, ascending; tags that this map lacks get a pose of NaN and the edge length
        `edge`, metres.
        """
        _, there, own = np.intersect1d(self.ids, ids, return_indices=True)
        poses, edges, sigmas = np.full((len(ids), 4, 4), np.nan), np.full(len(ids), edge), np.zeros((len(ids), 6))
        poses[own], edges[own], sigmas[own] = self.poses[there], self.edges[there], self.sigmas[there]
        return FixedMap(ids, poses, edges, sigmas, spread(self.joint, there, own, len(ids)))

    def prior(self, moved: BoolArray, mounts: Mounts | None = None) -> Prior:
        """Prior for a bundle adjustment. The prior has the poses of the map's tags that are not in the mask `moved`
        `(K,)`, and the prior `mounts` of the poses of the cameras on the body.

        In the covariance of a surveyed map, a common motion of all tags has zero variance. The prior raises all
        variances by a small amount, so that the covariance has an inverse.
        """
        trusted, tags = self.has & ~moved, np.where(self.has[:, None, None], self.poses, np.eye(4))
        own, rows = np.flatnonzero(trusted), rows_of(np.flatnonzero(trusted))
        information = np.linalg.inv(self.joint[np.ix_(rows, rows)] + LEAST_SIGMA**2 * np.eye(len(rows)))
        joint = spread(np.asarray(information, dtype=np.float64), np.arange(len(own)), own, len(trusted))
        return Prior(tags, np.repeat(trusted[:, None], 6, axis=1).astype(float), None, mounts, joint=joint)

    @classmethod
    def read(cls, path: Any, tag: Tag, errors: Hanging, **table: Any) -> "FixedMap":
        """Read a map in any format of `lmd.formats.tag_maps`, with its covariance. The covariance is read from the file
        that a survey writes beside its map; without this file, tags are independent.

        Args:
            path: file of the map.
            tag: family of the tags, and edge length of the tags without one in the file.
            errors: standard deviations of the poses of tags without a covariance.
            table: arguments `axes` (axes of a tag's frame) and `columns` (names of columns) of
                `lmd.formats.tag_maps.read_deployment`, for files that do not define them.

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
        sigmas = np.tile(errors.deviations, (len(ids), 1))
        if (covariance := _stated_covariance(path, deployment[order], sigmas)) is not None:
            sigmas = np.maximum(np.sqrt(np.diag(covariance)).reshape(-1, 6), LEAST_SIGMA)
        return cls(ids, poses, edges, sigmas, covariance, deployment.note)


def spread(matrix: FloatArray, chosen: IntArray, places: IntArray, count: int) -> FloatArray:
    """Square matrix with six rows and columns for each of `count` tags. The blocks of the tags `chosen` in `matrix`
    become the blocks of the tags `places` (both are indices); all other entries are 0.
    """
    result, rows, own = np.zeros((6 * count, 6 * count)), rows_of(places), rows_of(chosen)
    result[np.ix_(rows, rows)] = matrix[np.ix_(own, own)]
    return result


def surveyed_covariance(path: Any, deployment: Deployment) -> FloatArray | None:
    """Joint covariance of position and rotation of all tags of a surveyed map, in the world frame.

    Args:
        path: file of the map, as a survey writes it; the file of the joint covariance is beside it.
        deployment: K tags, in any order; tags that the survey lacks get zero covariance.

    Returns:
        covariance, m^2 and rad^2, with six rows for each tag, `(6 K, 6 K)`; None without the file of the joint
        covariance.

    Raises:
        InputError: the file cannot be read.
    """
    joint = _stated_covariance(path, deployment, np.zeros((len(deployment), 6)))
    turn = block_diag(*world_from_twists(poses_of(deployment)))
    return None if joint is None else np.asarray(turn @ joint @ turn.T)


def _stated_covariance(path: Any, tags: Deployment, sigmas: FloatArray) -> FloatArray | None:
    """Joint covariance `(6 K, 6 K)` of the K tags of a map, from the file that a survey writes beside it;
    None without the file.

    Args:
        path: file of the map.
        tags: K tags.
        sigmas: standard deviations of the tags that the file lacks, which are independent, `(K, 6)`.

    Raises:
        InputError: the file cannot be read.
    """
    beside = Path(str(path)).with_suffix(Path(FILE).suffix)
    if not beside.exists():
        return None
    among, covariance = read_map_covariance(beside, "map", tags)
    _, of, there = np.intersect1d(tags.ids, among, return_indices=True)
    alone = np.where(np.isin(np.arange(len(tags)), of)[:, None], 0.0, sigmas**2)
    return np.diag(alone.ravel()) + spread(covariance, there, of, len(tags))
