"""How high something is above the floor of a room."""

import numpy as np

from lmd.space.space import Space
from lmd.space.surface import Surface

LEVEL_NORMAL_Z = 0.99  # normals with a larger vertical part are those of what is level


def floor_of(room: Space) -> float:
    """Where the floor is, z, metres: the lowest of the large faces that look up, else the lowest point."""
    level = [face for face in room.faces() if face.normal[2] > LEVEL_NORMAL_Z]
    sizes = np.array([face.extent[0] * face.extent[1] for face in level])
    heights = np.array([face.origin[2] for face in level])
    return float(heights[sizes > sizes.max() / 2.0].min() if level else room.bounds()[0][2])


def lower_edge(room: Space, surface: Surface) -> float:
    """How high the lower edge of a wall is above the floor, metres; 0 for what is not upright."""
    return float(surface.origin[2]) - floor_of(room) if surface.is_upright else 0.0
