"""Rooms with vertical walls, made from files of floor plans: occupancy grids, field layouts of WPILib, and drawings.

A file does not state all that a room needs, such as the height of the ceiling. The user sets the rest as arguments of
`read_plan_room` and as fields of `Reading`. Drawings are read by `lmd.formats.dxf`.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from typing_extensions import override

from lmd.core.checks import (
    BoolArray,
    Checked,
    FloatArray,
    InputError,
    IntArray,
    NotNegative,
    Pair,
    Positive,
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
from lmd.formats.registry import read
from lmd.formats.tag_maps import read_deployment
from lmd.formats.trees import File, number_at
from lmd.space.free_region import OccupancyGrid, plan_of_grid
from lmd.space.parts import check_metres
from lmd.space.prism import Prism, from_floor_plan
from lmd.space.wall_lines import ReadPlan

KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
MODES = ("trinary", "scale", "raw")
OCCUPIED, FREE, UNKNOWN = 100, 0, -1
# Maximum number of cells (a warehouse of 300 m x 200 m at 5 cm has 24 million), and memory of a cell, bytes.
MOST_CELLS, CELL_BYTES = 36_000_000, 80.0
# Accepted formats of pictures, by Pillow's names; some other formats would start a program, such as Ghostscript.
FORMATS = ("PNG", "PPM", "BMP")
# Grey values that map_saver writes for unknown and for free cells.
SAVED_UNKNOWN, SAVED_FREE = 205, 254


def read_map(file: File) -> ReadPlan:
    """Read the region without obstacles in an occupancy grid as a floor plan, in the frame of the map.

    Args:
        file: YAML file of the map; its attribute `asked`, a mapping of the user's settings, has the keys `tolerance`,
            `speck`, `passage` and `start`, see `Reading`.

    Raises:
        InputError: the file or a setting is refused, or there is no free region.
    """
    settings = (file.asked[name] for name in ("tolerance", "speck", "passage", "start"))
    return plan_of_grid(read_occupancy_grid(file.path), *settings)


def read_occupancy_grid(path: str | Path) -> OccupancyGrid:
    """Read an occupancy grid: a YAML file, as nav2_map_server reads it, and the picture that the file names.

    A cell is occupied if its occupancy is at least `occupied_thresh`, and free if its occupancy is at most
    `free_thresh`. Other cells are neither, as in AMCL. The YAML file states these thresholds and the mode of the
    picture. In the mode `raw`, the grey values are occupancies in per cent, as in map_saver.

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
    """Occupancy `(H, W)` of each pixel of a map's picture, in per cent; -1 stands for unknown.

    In the modes `trinary` and `scale`, an occupied pixel gets 100 and a free pixel 0. Between the thresholds, `trinary`
    gives -1, and `scale` interpolates. In the mode `raw`, a grey value up to 100 is itself the occupancy, and the other
    arguments are not used.

    Args:
        grey: grey values from 0 to 255, `(H, W)`.
        is_opaque: mask of the pixels that are not transparent, `(H, W)`.
        mode: one of `MODES`: `trinary`, `scale` or `raw`.
        negate: True if white is occupied.
        occupied_thresh: smallest occupancy of a cell that counts as occupied, from 0 to 1.
        free_thresh: greatest occupancy of a cell that counts as free, from 0 to 1.
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
    """Path of the picture `image` that the YAML file `file` names; a relative path is relative to the YAML file.

    If there is no picture at this path, but one with its file name beside the YAML file, that picture is taken.
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
            if picture.mode.startswith("I"):  # 16 bits per pixel
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
    except Exception as error:  # a decoder may raise any error for a broken file
        reason = (
            f"its format is not {' or '.join(FORMATS)}" if type(error).__name__ == "UnidentifiedImageError" else error
        )
        raise InputError(f"image: {str(path)!r} cannot be read as a picture ({reason}).") from None


# Groups of tags around the bodies on a field, by season: the coral stations of 2025, whose walls cut the corners of the
# field, and its reefs; the hubs of 2026.
REEFSCAPE = (1,), (2,), (12,), (13,), range(6, 12), range(17, 23)
REBUILT = (2, 3, 4, 5, 8, 9, 10, 11), (18, 19, 20, 21, 24, 25, 26, 27)
SIZE = "field.{0}|field-dimensions.{0}"  # path to a length in an old or a new layout
# Distance of faces behind their tags, so that no rounding puts a tag inside; longest field, and length of what is cut
# off, metres.
BEHIND_M, FAR_M = 0.002, 100.0


def read_field(file: File) -> ReadPlan:
    """Read the playing field in a field layout of WPILib: a rectangle of the stated size, extended to contain all tags.

    If the tags are those of a known season, that season's solid structures are left out of the room, from floor to
    ceiling. The sides of a structure are the planes of its tags.

    Raises:
        InputError: the size of the field is missing or implausible, or the tags cannot be read.
    """
    import shapely

    tags = read_deployment(file.path)
    faces, normals = (tags.positions - BEHIND_M * tags.normals)[:, :2], tags.normals[:, :2]
    sides = normals @ [[0.0, 1.0], [-1.0, 0.0]]
    reach = FAR_M * np.stack([sides, -sides, -sides - normals, sides - normals], axis=1)
    behind = dict(zip(tags.ids.tolist(), shapely.polygons(faces[:, None] + reach), strict=True))
    bodies = {22: REEFSCAPE, 32: REBUILT}.get(len(tags), ()) if sorted(behind) == list(range(1, len(tags) + 1)) else ()
    solid = [shapely.intersection_all([behind[number] for number in body]) for body in bodies]
    with said_of(f"path: {str(file.path)!r}", "path"):
        size = [real(one, number_at(file.data, SIZE.format(one)), above=0.0, high=FAR_M) for one in ("length", "width")]
    whole = shapely.box(*np.minimum(faces.min(axis=0), 0.0), *np.maximum(faces.max(axis=0), size))
    field = shapely.simplify(whole.difference(shapely.union_all(solid)), BEHIND_M)
    return ReadPlan.of(str(file.path), shapely.orient_polygons(field), lambda _: (), f"a field of {size} m")


# Values of `conf/room/floor_plan.yaml`, which a plan from a file replaces.
EXAMPLE = {
    "outline": [[0, 0], [6, 0], [6, 2], [3, 2], [3, 4], [0, 4]],
    "holes": [[[1.3, 1.3], [1.7, 1.3], [1.7, 1.7], [1.3, 1.7]]],
    "keep_out": [{"name": "door", "surface": "wall_0", "from_left": [0.3, 1.2], "from_below": [0.0, 2.1]}],
}


# Tolerance in the comparison of lengths, metres.
ROUNDING_M = 1e-9


class PlanFile(File):
    """File of a floor plan; its attribute `asked` has the settings of `Reading`, keyed by name."""

    @override
    def refused(self, reason: str) -> InputError:
        return InputError(f"path: {str(self.path)!r}: {reason}.", "path")


@dataclass(frozen=True)
class Reading(Checked):
    """Settings for reading a floor plan from a file, such as the layers of a drawing that have walls.

    Raises:
        InputError: a setting is refused.
    """

    start: Pair | None = None
    """Point (x, y) in the room, in the frame of the file, metres; None for the largest region."""
    tolerance: Positive = 0.1
    """Maximum distance of a wall from the contour in the file, metres."""
    speck: NotNegative = 0.2
    """Size of specks in an occupancy grid, metres: a group of cells that are not free counts as free if both sides of
    its bounding box are shorter than `speck`.
    """
    passage: NotNegative = 0.3
    """Minimum width of parts of an occupancy grid's free region, metres; narrower parts are left out."""
    layers: Sequence[str] | None = None
    """Names of a drawing's layers with walls; None for the layers whose names mean walls."""
    unit: str | None = None
    """Unit of a drawing, one of `lmd.space.parts.UNITS`; None for the unit that the drawing states."""
    gap: NotNegative = 1.3
    """Maximum width of the gaps between walls of a drawing, such as doors, that are treated as closed, metres."""
    least_width: NotNegative = 0.4
    """Minimum free width of a wall, metres: the length of its longest part without doors and windows. Walls with less
    free width carry no landmarks unless the user names them.
    """


def read_plan_room(
    outline: Any = None,
    height: Any = None,
    reachable: Any = None,
    spacing: Any = None,
    path: Any = None,
    holes: Any = (),
    keep_out: Any = (),
    surfaces: Any = None,
    margin: Any = 0.0,
    **more: Any,
) -> Prism:
    """Make a room from a floor plan in a file, in the file's frame, or from a plan that the other arguments describe.

    Args:
        path: file of a format of this module; None for a plan from the other arguments.
        outline, holes: vertices of the walls and of pillars, see `FloorPlan`. With a `path` they come from the file;
            both must then be empty, or have the values of the example in the configuration, `EXAMPLE`.
        keep_out: parts of surfaces without landmarks, see `FloorPlan`. With a `path` they are added to the keep-outs of
            the file; those of `EXAMPLE` are ignored.
        surfaces: names of the surfaces that may carry landmarks; with a `path`, None for all walls with at least the
            free width `least_width`.
        height, margin: height of the ceiling, and distance of landmarks from the edges of a surface, metres.
        reachable, spacing: reachable volume, and largest distance between positions, see `Prism`.
        more: fields of `Reading`, and further arguments of `from_floor_plan`.

    Raises:
        InputError: the file or a value is refused.
    """
    names = {field.name for field in fields(Reading)}
    asked, plan = ({name: more[name] for name in more if (name in names) == of_file} for of_file in (True, False))
    if path is None:
        if outline is None:
            raise InputError("path is missing: a file with a floor plan is needed, such as map.yaml.", "path")
        plan |= {"holes": holes, "keep_out": keep_out, "surfaces": surfaces, "margin": margin}
        return from_floor_plan(outline, height, reachable, spacing, **plan)
    for name, value in (("outline", outline), ("holes", holes)):
        if value not in (None, (), [], EXAMPLE[name]):
            raise InputError(f"{name} and path are both given: leave out {name}, or set path=null.", name)
    reading, height, margin = Reading(**asked), real("height", height, above=0.0), real("margin", margin, low=0.0)
    found: ReadPlan = read("floor plan", PlanFile(file_path("path", path), asked=vars(reading)))
    size = [*np.ptp(found.rings[0], axis=0), height]
    check_metres(size, f"path: {str(path)!r} with {found.scale} makes", "check its unit", "path")
    walls, parts = _walls(found, height, margin, reading.least_width)
    if surfaces is None and not walls:
        raise InputError(f"path: {str(path)!r} has no wall with a free width of {reading.least_width:g} m.", "path")
    outer, *inner = [ring.tolist() for ring in found.rings]
    plan |= {"holes": inner, "surfaces": walls if surfaces is None else surfaces, "margin": margin}
    plan["keep_out"] = [*parts, *([] if keep_out == EXAMPLE["keep_out"] else keep_out)]
    return from_floor_plan(outer, height, reachable, spacing, path=str(path), note=found.note, **plan)


def _walls(found: ReadPlan, height: float, margin: float, least_width: float) -> tuple[list[str], list[dict[str, Any]]]:
    """Names of the walls with at least the free width `least_width`; and the regions of all doors and windows.

    The free width of a wall is the length of its longest part without doors and windows. No landmark may be in a
    region, which is returned as a mapping with the arguments of `KeepOut`.
    """
    walls: list[str] = []
    parts: list[dict[str, Any]] = []
    for i, ring in enumerate(found.rings):
        lengths = np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1)
        for j, length in enumerate(lengths.tolist()):
            name = f"wall_{j}" if i == 0 else f"hole_{i - 1}_wall_{j}"
            spans = sorted((each.start, each.stop, each.name) for each in found.stretches if each[:2] == (i, j))
            free, reached = 0.0, margin
            for start, stop, _ in [*spans, (length - margin, length, "")]:
                free, reached = max(free, start - reached), max(reached, stop)
            if free > ROUNDING_M and free >= least_width - ROUNDING_M:
                walls.append(name)
            for start, stop, label in spans:
                # The left end of a wall, as seen from the room, is the second corner of an edge of the outline.
                left = [start, stop] if i else [length - stop, length - start]
                parts.append({"surface": name, "from_left": left, "from_below": [0.0, height], "name": label})
    return walls, parts
