"""Encodings (the paper's W): deployments as genes in the unit box, and back.

An optimiser moves genes in [0, 1]; an encoding says which landmarks they mean. Genes come landmark by landmark.
"""

from typing import Protocol

import numpy as np

from lmd.checks import FloatArray, InputError, choice
from lmd.deployment import Deployment
from lmd.geometry.frames import landmark_normal, normal_angles
from lmd.space.cuboid import Room

# A landmark within this distance (m) of a wall is on it; a normal within this of the wall's is flush.
ON_WALL = 1e-6
# Keeps an encoded point off the border to the neighbouring wall, as a fraction of the wall.
BORDER = 1e-12


class Encoding(Protocol):
    """Genes of one deployment or many."""

    @property
    def genes_per_landmark(self) -> int:
        """How many genes describe one landmark."""

    def decode(self, genes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions and normals `(B, K, 3)` of genes `(B, K * genes_per_landmark)` in [0, 1]."""

    def encode(self, deployment: Deployment) -> FloatArray:
        """Genes `(K * genes_per_landmark,)` that decode to `deployment`.

        Raises:
            InputError: a landmark is on no wall that may carry it, or tilted where the encoding is flush.
        """


class _OnWalls:
    """What both encodings share: the walls as arrays, and finding the wall of a landmark."""

    def __init__(self, room: Room, flush: bool) -> None:
        self.room = room
        self.flush = flush
        self.walls = room.landmark_walls()
        self.origin = np.array([wall.origin for wall in self.walls])
        self.u = np.array([wall.u for wall in self.walls])
        self.v = np.array([wall.v for wall in self.walls])
        self.normal = np.array([wall.normal for wall in self.walls])
        self.extent = np.array([wall.extent for wall in self.walls])

    def _depth(self, points: FloatArray) -> FloatArray:
        """Distance of points `(..., 3)` from the plane of each wall, `(..., W)`."""
        return np.asarray(((points[..., None, :] - self.origin) * self.normal).sum(axis=-1))

    def _wall_of(self, deployment: Deployment) -> np.ndarray:
        """Index of the wall each landmark is on, `(K,)`; at an edge, the one it faces away from most."""
        on_wall = np.abs(self._depth(deployment.positions)) <= ON_WALL
        if not on_wall.any(axis=1).all():
            k = int(np.argmin(on_wall.any(axis=1)))
            x, y, z = deployment.positions[k]
            raise InputError(
                f"landmark {k} at ({x:g}, {y:g}, {z:g}) is on no wall that may carry landmarks "
                f"({', '.join(self.room.walls)}), so it cannot be a start."
            )
        facing = deployment.normals @ self.normal.T
        wall = np.argmax(np.where(on_wall, facing, -np.inf), axis=1)
        cosine = facing[np.arange(len(wall)), wall]
        if cosine.min() < 0.0:
            raise InputError(f"landmark {int(np.argmin(cosine))} faces into its wall, so it cannot be a start.")
        deviation = np.linalg.norm(deployment.normals - self.normal[wall], axis=1)
        if self.flush and deviation.max() > ON_WALL:
            raise InputError(
                f"landmark {int(np.argmax(deviation))} is not flush with its wall; set encoding.flush=false to start "
                "from tilted landmarks."
            )
        return np.asarray(wall)


class PaperEncoding(_OnWalls):
    """Five genes a landmark as printed: x, y, z, yaw rho, pitch eta.

    The point is projected to the nearest wall that may carry landmarks. With `flush` the landmark takes the
    wall's normal and the two angle genes, though part of the chromosome, have no effect.
    """

    genes_per_landmark = 5

    def decode(self, genes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `Encoding.decode`."""
        g = genes.reshape(len(genes), -1, 5)
        points = g[..., :3] * np.asarray(self.room.size)
        depth = self._depth(points)
        wall = np.argmin(np.abs(depth), axis=-1)
        nearest = np.take_along_axis(depth, wall[..., None], axis=-1)
        positions = np.clip(points - nearest * self.normal[wall], 0.0, np.asarray(self.room.size))
        if self.flush:
            return positions, self.normal[wall]
        return positions, landmark_normal((2.0 * g[..., 3] - 1.0) * np.pi, (g[..., 4] - 0.5) * np.pi)

    def encode(self, deployment: Deployment) -> FloatArray:
        """See `Encoding.encode`."""
        wall = self._wall_of(deployment)
        points = np.clip(deployment.positions, 0.0, np.asarray(self.room.size))
        # A point on an edge is as near to a second wall: step away from that one, so that decoding finds its own.
        depth = self._depth(points)
        tied = (np.abs(depth) <= ON_WALL) & (np.arange(len(self.walls)) != wall[:, None])
        points = points + 2.0 * ON_WALL * (tied[..., None] * self.normal).sum(axis=1)
        yaw, pitch = normal_angles(deployment.normals)
        angles = np.stack([yaw / (2.0 * np.pi) + 0.5, pitch / np.pi + 0.5], axis=1)
        return np.clip(np.hstack([points / np.asarray(self.room.size), angles]), 0.0, 1.0).reshape(-1)


class WallEncoding(_OnWalls):
    """Two genes a landmark: a coordinate along the walls laid side by side, and a height on the wall.

    Each wall takes a share of the first gene in proportion to its area, so uniform genes are uniform over the
    walls. Without `flush`, two more genes turn the normal by up to 90 degrees along the wall's u and v axes.
    """

    def __init__(self, room: Room, flush: bool) -> None:
        super().__init__(room, flush)
        share = np.array([wall.area for wall in self.walls])
        self.edges = np.concatenate([[0.0], np.cumsum(share / share.sum())])
        self.edges[-1] = 1.0

    @property
    def genes_per_landmark(self) -> int:
        """Two when flush, four otherwise."""
        return 2 if self.flush else 4

    def decode(self, genes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `Encoding.decode`."""
        g = genes.reshape(len(genes), -1, self.genes_per_landmark)
        wall = np.clip(np.searchsorted(self.edges, g[..., 0], side="right") - 1, 0, len(self.walls) - 1)
        along = (g[..., 0] - self.edges[wall]) / (self.edges[wall + 1] - self.edges[wall])
        at = np.stack([along, g[..., 1]], axis=-1) * self.extent[wall]
        positions = self.origin[wall] + at[..., :1] * self.u[wall] + at[..., 1:] * self.v[wall]
        positions = np.clip(positions, 0.0, np.asarray(self.room.size))
        if self.flush:
            return positions, self.normal[wall]
        turn, tilt = (g[..., 2, None] - 0.5) * np.pi, (g[..., 3, None] - 0.5) * np.pi
        level = np.cos(turn) * self.normal[wall] + np.sin(turn) * self.u[wall]
        return positions, np.cos(tilt) * level + np.sin(tilt) * self.v[wall]

    def encode(self, deployment: Deployment) -> FloatArray:
        """See `Encoding.encode`."""
        wall = self._wall_of(deployment)
        offset = deployment.positions - self.origin[wall]
        at = np.stack([(offset * self.u[wall]).sum(axis=1), (offset * self.v[wall]).sum(axis=1)], axis=1)
        along, height = np.clip(at / self.extent[wall], 0.0, 1.0).T
        first = self.edges[wall] + np.clip(along, BORDER, 1.0 - BORDER) * (self.edges[wall + 1] - self.edges[wall])
        if self.flush:
            return np.stack([first, height], axis=1).reshape(-1)
        normals = deployment.normals
        turn = np.arctan2((normals * self.u[wall]).sum(axis=1), (normals * self.normal[wall]).sum(axis=1))
        tilt = np.arcsin(np.clip((normals * self.v[wall]).sum(axis=1), -1.0, 1.0))
        genes = np.stack([first, height, turn / np.pi + 0.5, tilt / np.pi + 0.5], axis=1)
        return np.clip(genes, 0.0, 1.0).reshape(-1)


def make_encoding(kind: str, room: Room, flush: bool) -> Encoding:
    """The encoding called `kind`: `paper` or `wall`.

    Raises:
        InputError: there is no such encoding.
    """
    choice("encoding.kind", kind, ("paper", "wall"))
    return PaperEncoding(room, flush) if kind == "paper" else WallEncoding(room, flush)
