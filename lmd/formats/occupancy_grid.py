"""Occupancy grids of ROS: `map.yaml` with a picture, read like nav2_map_server does, and their floor plans.

Source: `loadMapFromFile` of nav2_map_server. A cell is occupied at 100, free at 0, and unknown at -1.
"""

import io
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import (
    BoolArray,
    FloatArray,
    InputError,
    IntArray,
    bounded,
    choice,
    file_path,
    real,
    said_of,
    vector,
)
from lmd.core.files import read_bytes, read_keys
from lmd.core.memory import check_memory
from lmd.core.optional import optional
from lmd.formats.trees import File
from lmd.space.free_region import OccupancyGrid, plan_of_grid
from lmd.space.wall_lines import ReadPlan

KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
MODES = ("trinary", "scale", "raw")
OCCUPIED, FREE, UNKNOWN = 100, 0, -1
# Greatest number of cells, where a warehouse of 300 m x 200 m at 5 cm has 24 million; and memory of a cell, bytes.
MOST_CELLS, CELL_BYTES = 36_000_000, 80.0
# Formats of pictures, by Pillow's names; of others some start a program, such as Ghostscript.
FORMATS = ("PNG", "PPM", "BMP")
# Grey values that map_saver writes for unknown and for free cells.
SAVED_UNKNOWN, SAVED_FREE = 205, 254


def read_map(file: File) -> ReadPlan:
    """Read the free region of an occupancy grid, in the frame of the map.

    Args:
        file: YAML file of the map; `asked` has `tolerance`, `speck`, `passage` and `start` of `Reading`.

    Raises:
        InputError: the file or a setting is refused, or there is no free region.
    """
    settings = (file.asked[name] for name in ("tolerance", "speck", "passage", "start"))
    return plan_of_grid(read_occupancy_grid(file.path), *settings)


def read_occupancy_grid(path: str | Path) -> OccupancyGrid:
    """Read the map of a YAML file and its picture.

    In the modes `trinary` and `scale`, cells between the thresholds are neither free nor occupied, as in AMCL. In the
    mode `raw` the thresholds apply to the occupancy, as in map_saver.

    Raises:
        InputError: a file is missing or cannot be read, or a key is missing or wrong.
    """
    file = file_path("path", path)
    keys = read_keys(file, "path")
    with said_of(f"path: {str(file)!r}", "path"):
        if lacking := [name for name in KEYS if name not in keys]:
            raise InputError(f"the key {lacking[0]} is missing, which nav2_map_server needs too.")
        resolution = real("resolution", keys["resolution"], above=0.0)
        x, y, yaw = vector("origin", keys["origin"], 3)
        occupied, free = (real(name, keys[name]) for name in ("occupied_thresh", "free_thresh"))
        if free >= occupied:
            raise InputError(f"free_thresh = {free:g} must be below occupied_thresh = {occupied:g}.")
        mode = choice("mode", str(keys.get("mode", MODES[0])).lower(), MODES)
        if (negate := keys["negate"]) not in (0, 1):
            raise InputError(f"negate must be 0, 1, true or false, got {negate!r}.")
        grey, is_opaque = _picture(_beside(file, keys["image"]))
    cells = occupancy(grey, is_opaque, mode, bool(negate), occupied, free)[::-1]
    if mode == "raw":
        is_occupied, is_free = cells >= 100.0 * occupied, (cells >= 0) & (cells <= 100.0 * free)
        return OccupancyGrid(str(path), cells, resolution, (x, y, yaw), is_occupied, is_free)
    is_free, note = cells == FREE, ""
    saved = grey[::-1] == SAVED_UNKNOWN
    if not negate and (saved & is_free).any() and (grey == SAVED_FREE).any():
        is_free = is_free & ~saved
        note = (
            f"free_thresh = {free:g} makes nav2 drive over the grey {SAVED_UNKNOWN} that map_saver writes for "
            "unknown cells; here they are unknown"
        )
    return OccupancyGrid(str(path), cells, resolution, (x, y, yaw), cells == OCCUPIED, is_free, note)


def occupancy(
    grey: FloatArray, is_opaque: BoolArray, mode: str, negate: bool, occupied_thresh: float, free_thresh: float
) -> IntArray:
    """Occupancy in per cent, -1 for unknown, `(H, W)`, of the pixels of a map.

    Args:
        grey: grey values from 0 to 255, `(H, W)`.
        is_opaque: mask of the pixels that are not transparent, `(H, W)`.
        mode: one of `MODES`.
        negate: True if white is occupied.
        occupied_thresh: least occupancy of an occupied cell, from 0 to 1.
        free_thresh: greatest occupancy of a free cell, from 0 to 1.
    """
    if mode == "raw":
        return np.where(grey <= OCCUPIED, grey, UNKNOWN).astype(np.int8)
    # nav2 compares in single precision.
    occupied, free = np.float32(occupied_thresh), np.float32(free_thresh)
    value = grey.astype(np.float32) / np.float32(255.0)
    value = value if negate else np.float32(1.0) - value
    cells = np.where(value >= occupied, OCCUPIED, UNKNOWN)
    if mode == "scale":
        between = np.round((value - free) / (occupied - free) * 100.0)
        cells = np.where((value > free) & (value < occupied), between, cells)
    cells = np.where(value <= free, FREE, cells)
    return np.where(is_opaque, cells, UNKNOWN).astype(np.int8)


def _beside(file: Path, image: Any) -> Path:
    """Path of a picture, relative to the YAML file. If an absolute path does not exist, the picture is searched beside
    the YAML file.
    """
    if not isinstance(image, str) or not image.strip():
        raise InputError(f"image must be the path of the picture, got {image!r}.")
    picture = file.parent / image
    beside = file.parent / Path(image.replace("\\", "/")).name
    return beside if not picture.exists() and beside.exists() else picture


def _picture(path: Path) -> tuple[FloatArray, BoolArray]:
    """Grey values from 0 to 255, and mask of the opaque pixels of a picture, `(H, W)` each; the first row is on top."""
    Image = optional("PIL.Image", "analysis")  # noqa: N806 # a module
    content = read_bytes(path, "image")
    if not content or content.startswith(b"version https://git-lfs"):
        kind = "a pointer of Git LFS: `git lfs pull` fetches the picture" if content else "empty"
        raise InputError(f"image: {str(path)!r} cannot be read as a picture: it is {kind}.")
    try:
        with Image.open(io.BytesIO(content), formats=FORMATS) as picture:
            cells = picture.width * picture.height
            bounded("cells", cells, MOST_CELLS, f"image: {str(path)!r}")
            check_memory(CELL_BYTES * cells, f"image: {str(path)!r}")
            if picture.mode.startswith("I"):  # 16 bits
                grey = np.round(np.asarray(picture, dtype=np.float64) / 257.0)
                return grey.astype(np.uint8), np.ones(grey.shape, dtype=np.bool_)
            if picture.mode == "P":
                picture = picture.convert("RGBA" if "transparency" in picture.info else "RGB")
            is_opaque = np.ones((picture.height, picture.width), dtype=np.bool_)
            if "A" in picture.getbands():
                is_opaque = np.asarray(picture.getchannel("A")) == 255
            return np.asarray(picture.convert("L")), is_opaque
    except InputError:
        raise
    except Exception as error:  # a decoder of a broken file may raise anything
        reason = (
            f"its kind is none of {', '.join(FORMATS)}" if type(error).__name__ == "UnidentifiedImageError" else error
        )
        raise InputError(f"image: {str(path)!r} cannot be read as a picture ({reason}).") from None
