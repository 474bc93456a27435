"""Cylinders of a crowd as faces of prisms, for a renderer."""

import numpy as np

from lmd.core.checks import FloatArray
from lmd.space.crowd import BOTTOM, RADIUS, TOP, X, Y
from lmd.space.surface import Surface

SIDES = 32  # number of sides of a prism; its outline is at most r (1 - cos(pi / 32)) / 2, 0.6 mm of 25 cm, off


def faces_of(people: FloatArray) -> tuple[Surface, ...]:
    """Sides and tops of the cylinders `(N, 5)`."""
    import shapely

    faces = []
    half = np.pi / SIDES
    for i, person in enumerate(people):
        low, height = person[BOTTOM], float(person[TOP] - person[BOTTOM])
        radius = person[RADIUS] * 2.0 / (1.0 + np.cos(half))  # vertices as far outside of the cylinder as sides inside
        angles = 2.0 * half * np.arange(SIDES + 1)
        ring = np.stack([np.cos(angles), np.sin(angles)], axis=-1) * radius
        for j in range(SIDES):
            way = ring[j + 1] - ring[j]
            width = float(np.linalg.norm(way))
            u = np.array([*(way / width), 0.0])
            origin = np.array([*(person[[X, Y]] + ring[j]), low])
            normal = np.array([u[1], -u[0], 0.0])
            faces.append(Surface(f"person_{i}_side_{j}", origin, u, np.array([0.0, 0.0, 1.0]), normal, (width, height)))
        corner = np.array([*(person[[X, Y]] - radius), person[TOP]])
        top = shapely.Polygon(ring[:-1] + radius)
        ex, ey, ez = np.eye(3)
        faces.append(Surface(f"person_{i}_top", corner, ex, ey, ez, (2.0 * radius, 2.0 * radius), top))
    return tuple(faces)
