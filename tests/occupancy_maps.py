"""Occupancy grids that tests share."""

import numpy as np
import yaml
from PIL import Image

FREE, UNKNOWN, OCCUPIED = 254, 205, 0
KEYS = {"resolution": 0.05, "origin": [-0.5, -0.5, 0.0], "negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.196}


def hall(width=6.0, depth=4.0, cell=0.05):
    """Grey values of a hall with walls of 0.1 m and unknown cells beyond; row 0 has the lowest y.

    The inner corner of the hall is 0.5 m from the corner of the picture.
    """
    rows, columns = round((depth + 1.0) / cell), round((width + 1.0) / cell)
    grey = np.full((rows, columns), UNKNOWN, dtype=np.uint8)
    box(grey, -0.1, -0.1, width + 0.1, depth + 0.1, OCCUPIED, cell)
    box(grey, 0.0, 0.0, width, depth, FREE, cell)
    return grey


def box(grey, x, y, x_end, y_end, value, cell=0.05):
    """Fill a box, metres from the inner corner of the hall."""
    a, b, c, d = (round((at + 0.5) / cell) for at in (x, y, x_end, y_end))
    grey[b:d, a:c] = value


def write_map(folder, grey, name="map", suffix=".pgm", **keys):
    """Write a picture and its YAML; returns the path of the YAML as a text."""
    Image.fromarray(grey[::-1]).save(folder / f"{name}{suffix}")
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump({"image": f"{name}{suffix}", **KEYS, **keys}))
    return str(path)
