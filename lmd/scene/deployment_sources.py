"""Sources of deployments: random, uniform, existing (read from a file), or given."""

from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Protocol

import numpy as np

from lmd.core.checks import Checked, FloatArray, IntArray, choice, integer
from lmd.core.memory import check_memory
from lmd.scene.deployment import Deployment
from lmd.scene.tag import Tag
from lmd.space.space import Space
from lmd.space.surface import SurfaceArrays

# Memory of a landmark while a deployment is made, bytes: a dozen vectors.
LANDMARK_BYTES = 400
POINT = Tag()


class DeploymentSource(Protocol):
    """Interface: a source draws a deployment, from which an optimiser starts or which `evaluate` assesses."""

    @property
    def varies(self) -> bool:
        """True if the deployments are random, so that two draws may differ."""

    def draw(self, room: Space, rng: np.random.Generator, tag: Tag = POINT) -> Deployment:
        """Draw a deployment in `room`; each landmark stores the index of its surface.

        Args:
            room: room whose surfaces contain only the allowed positions of the landmarks' centres.
            rng: random generator.
            tag: tag of the landmarks. If it has several sizes, they are assigned in the order of the landmarks, see
                `Tag.edges_in_order`.
        """


def landmark_count(name: str, value: Any) -> int:
    """Return `value` as K, the number of landmarks that a source draws.

    Raises:
        InputError: the value is not a positive whole number, or the landmarks would not fit into memory.
    """
    count = integer(name, value, low=1)
    check_memory(count * LANDMARK_BYTES, f"{name} = {count} landmarks", name)
    return count


LandmarkCount = Annotated[int, landmark_count]


@dataclass(frozen=True)
class RandomDeployment(Checked):
    """Random landmarks flush with the walls; the probability of a wall is proportional to its area."""

    count: LandmarkCount
    varies = True

    def draw(self, room: Space, rng: np.random.Generator, tag: Tag = POINT) -> Deployment:
        """See `DeploymentSource.draw`."""
        surfaces = SurfaceArrays.of(room.surfaces())
        area = surfaces.area
        picked = rng.choice(len(area), size=self.count, p=area / area.sum())
        at = surfaces.spread(picked, rng.random((self.count, 2)))
        return _flush(surfaces, surfaces.of_piece[picked], at, tag)


@dataclass(frozen=True)
class UniformDeployment(Checked):
    """Landmarks at the centres of a regular grid on each wall, flush with the wall.

    Args:
        count: number of landmarks K.
        layout: `per_wall` for equal numbers on all walls, as in the paper (15 on each wall), or `by_area` for numbers
            in proportion to the areas of the walls. If K is not divisible by the number of walls, `per_wall` gives the
            largest walls one landmark more.
    """

    count: LandmarkCount
    layout: Annotated[str, partial(choice, options=("per_wall", "by_area"))] = "per_wall"
    varies = False

    def draw(self, room: Space, rng: np.random.Generator, tag: Tag = POINT) -> Deployment:
        """See `DeploymentSource.draw`; the result is deterministic."""
        surfaces = room.surfaces()
        area = np.array([surface.area for surface in surfaces])
        share = area / area.sum() if self.layout == "by_area" else np.full(len(area), 1.0 / len(area))
        quota = share * self.count
        counts = np.floor(quota + 1e-9).astype(int)
        # Surfaces with the largest remainder first, of equal ones the largest surface.
        order = np.lexsort((-area, -np.round(quota - counts, 9)))
        counts[order[: self.count - counts.sum()]] += 1
        grids = [surface.grid(n) for surface, n in zip(surfaces, counts, strict=True)]
        at = np.array([point for grid in grids for point in grid])
        return _flush(SurfaceArrays.of(surfaces), np.repeat(np.arange(len(surfaces)), counts), at, tag)


class ExistingDeployment:
    """Base of sources of existing landmarks, which are not moved.

    Attributes:
        path: file of the landmarks, for messages.
        free: True to skip the check of placement. Landmarks may then be outside the room or on no surface, and may
            overlap.
    """

    path: str | None
    free: bool
    varies = False


@dataclass(frozen=True)
class GivenDeployment:
    """Source that returns a given deployment.

    Args:
        deployment: deployment whose `surfaces` are set.
    """

    deployment: Deployment
    varies = False

    def draw(self, room: Space, rng: np.random.Generator, tag: Tag = POINT) -> Deployment:
        """See `DeploymentSource.draw`; the result is deterministic."""
        return self.deployment


def _flush(surfaces: SurfaceArrays, surface: IntArray, at: FloatArray, tag: Tag) -> Deployment:
    """Deployment of landmarks at given positions, each flush with its surface.

    Args:
        surfaces: surfaces of the room.
        surface: index of each landmark's surface, `(K,)`.
        at: coordinates of each landmark along u and v of its surface, metres, `(K, 2)`.
        tag: tag that gives the edge lengths.
    """
    points, normals = surfaces.points(surface, at), surfaces.normal[surface]
    return Deployment(points, normals, surface, edges=tag.edges_in_order(len(surface)))
