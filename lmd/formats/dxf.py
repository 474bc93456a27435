"""Floor plans in DXF drawings."""

import io
import logging
import re
from collections import Counter
from collections.abc import Iterator
from itertools import count
from typing import Any

import numpy as np

from lmd.core.checks import LARGEST, FloatArray, InputError, bounded, choice
from lmd.core.files import read_bytes
from lmd.core.optional import optional
from lmd.core.words import few
from lmd.formats.trees import File
from lmd.space.parts import UNITS
from lmd.space.wall_lines import Drawing, ReadPlan, plan_of

# Units by their codes in $INSUNITS.
CODES = {1: "inches", 2: "feet", 4: "millimetres", 5: "centimetres", 6: "metres"}
# Words for layers and blocks in drawings, in several languages.
WALL = re.compile(r"wall|wand|waende|wände|mauer|mur|pared|parede|vegg|vägg|стен|墙|壁", re.IGNORECASE)
DOOR = re.compile(r"door|tür|tuer|porte|puerta|porta(?!l)|двер|门|ドア", re.IGNORECASE)
WINDOW = re.compile(r"window|wind\b|glaz|fenster|fenêtre|fenetre|ventana|janela|окн|窗|窓", re.IGNORECASE)
SHAPES = ("LINE", "LWPOLYLINE", "POLYLINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE")
# First version of DXF with subclasses.
NEWER = b"AC1015"
NESTED = ("INSERT", "MLINE")
NOT_SHOWN = "what a CAD program does not show (layers that are off or frozen, invisible parts)"
# Maximum number of entities, including those in blocks, and of vertices of shapes (a plan of a hospital has 50,000);
# maximum nesting of blocks; and maximum extent of a shape, in tolerances.
MOST_ENTITIES, MOST_VERTICES, DEEPEST, LONGEST = 200_000, 500_000, 32, 1e8


def read_drawing(file: File) -> ReadPlan:
    """Read the room in a drawing, in the frame of the drawing.

    Args:
        file: drawing; its attribute `asked`, a mapping of the user's settings, has the keys `layers`, `unit`, `gap`,
            `tolerance` and `start`, see `lmd.formats.plans.Reading`.

    Raises:
        InputError: the file cannot be read, a layer or the unit is unknown, or the walls enclose no room.
    """
    return plan_of(str(file.path), _lines(file), file.asked["gap"], file.asked["start"])


def _lines(file: File) -> Drawing:
    import shapely

    ezdxf = optional("ezdxf", "drawings")
    content = read_bytes(file.path, "path")
    if b"\0" in content and not content.startswith(b"AutoCAD Binary DXF"):
        raise InputError(f"path: {str(file.path)!r} cannot be read as DXF: it is neither text nor binary DXF.", "path")
    optional("ezdxf.recover", "drawings")
    logging.getLogger("ezdxf").setLevel(logging.CRITICAL)  # ezdxf logs each entity that it repairs
    try:
        document, _ = ezdxf.recover.read(io.BytesIO(_with_subclasses(content)))
        found = list(_shapes(document.modelspace(), document.layers, f"path: {str(file.path)!r}", count(1)))
    except InputError:
        raise
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError, ezdxf.DXFError) as error:
        raise InputError(f"path: {str(file.path)!r} cannot be read as DXF ({error}).", "path") from None
    drawn, hidden = (Counter(layer for kind, layer, _ in found if kind == own) for own in ("line", "hidden"))
    if not drawn:
        only = f", except for {NOT_SHOWN}: {_counted(hidden)}" if hidden else ""
        raise InputError(f"path: {str(file.path)!r} cannot be read as DXF: it has no lines{only}.", "path")
    layers = _layers(file, drawn, hidden)
    unit = _unit(
        file, int(document.header.get("$INSUNITS", 0) or 0), [e for k, n, e in found if k == "line" and n in layers]
    )
    scale = UNITS[unit]
    paths: dict[str, list[FloatArray]] = {"line": [], "window": []}
    boxes, number = [], count(1)
    for kind, layer, entity in found:
        if kind == "hidden" or (kind == "line" and layer not in layers):
            continue
        vertices = scale * _flattened(entity, file.asked["tolerance"] / scale, f"path: {str(file.path)!r}", number)
        if kind in paths and len(vertices) > 1:
            paths[kind].append(vertices)
        if kind in ("door", "window") and len(vertices) > 1:
            boxes.append((kind, shapely.box(*vertices.min(axis=0), *vertices.max(axis=0))))
    if not paths["line"]:
        raise InputError(f"path: {str(file.path)!r} has no lines of walls.", "path")
    left = Counter({name: number for name, number in drawn.items() if name not in layers})
    note = f"walls are the lines of {', '.join(sorted(layers))}"
    note += f", without those of {_counted(left)}" if left else ""
    named = file.asked["layers"] is not None or any(map(WALL.search, layers))  # else other layers might have walls
    unseen = Counter({key: n for key, n in hidden.items() if key in layers or not named or WALL.search(key)})
    note += f", without {NOT_SHOWN}: {_counted(unseen)}" if unseen else ""
    walls, windows = (shapely.MultiLineString(lines) for lines in paths.values())
    return Drawing(walls, windows, boxes, unit, note)


def _with_subclasses(content: bytes) -> bytes:
    """Content of a DXF drawing, with the subclass markers of polylines added, which some programs omit."""
    lines = content.replace(b"\r\n", b"\n").split(b"\n")
    if b"LWPOLYLINE" not in content or b"AcDbPolyline" in content:
        return content
    result, i = [], 0
    while i + 1 < len(lines):
        result += lines[i : i + 2]
        i += 2
        if lines[i - 1].strip() == b"LWPOLYLINE":
            own: dict[bool, list[bytes]] = {True: [], False: []}
            while i + 1 < len(lines) and lines[i].strip() != b"0":
                own[lines[i].strip() in (b"5", b"6", b"8", b"62")] += lines[i : i + 2]
                i += 2
            result += [b"100", b"AcDbEntity", *own[True], b"100", b"AcDbPolyline", *own[False]]
    text = b"\n".join([*result, b""]).replace(b"AC1009", NEWER)
    return text if b"$ACADVER" in text else b"0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\n" + NEWER + b"\n0\nENDSEC\n" + text


def _counted(layers: Counter[str]) -> str:
    """Text with the names of the layers, and the number of shapes on each layer."""
    return few([f"{name} ({number})" for name, number in layers.most_common()], most=8)


def _shapes(
    entities: Any,
    layers: Any,
    source: str,
    number: Iterator[int],
    kind: str = "line",
    outer: str = "0",
    shown: bool = True,
    depth: int = 0,
) -> Iterator[tuple[str, str, Any]]:
    """Yield kind, layer name and entity of each shape in a drawing, including the shapes in blocks.

    The kind is `line`, `door` or `window`, or `hidden` for a shape that CAD programs do not show. A block, which is a
    group of entities, has a layer, too. If this layer is frozen, all shapes of the block are hidden; if this layer is
    off, only the block's shapes on layer 0 are hidden.

    The counter `number` advances with each entity; more than `MOST_ENTITIES` are refused. The arguments from `kind` on
    describe the block that contains the entities: kind, layer, True if the block is shown, and depth of nesting.
    """
    bounded("nested blocks", depth, DEEPEST, source, "path")
    for entity in entities:
        bounded("entities, with those in blocks", next(number), MOST_ENTITIES, source, "path")
        layer = entity.dxf.layer if entity.dxf.layer != "0" else outer
        state = layers.get(layer) if layer in layers else None
        visible = shown and not entity.dxf.get("invisible", 0) and (state is None or not state.is_frozen())
        name = f"{layer} {entity.dxf.get('name', '')}" if entity.dxftype() == "INSERT" else layer
        own = "window" if WINDOW.search(name) else "door" if DOOR.search(name) else kind
        if entity.dxftype() in NESTED:
            yield from _shapes(entity.virtual_entities(), layers, source, number, own, layer, visible, depth + 1)
        elif entity.dxftype() in SHAPES:
            yield own if visible and (state is None or not state.is_off()) else "hidden", layer, entity


def _flattened(entity: Any, tolerance: float, source: str, number: Iterator[int]) -> FloatArray:
    """Vertices of the polyline that approximates a shape, `(N, 2)`, in the unit of the drawing.

    A shape without a path, such as a mesh, has no vertices. `tolerance` is the maximum distance between shape and
    polyline, in the same unit. The counter `number` limits the total number of vertices of all shapes.
    """
    make_path = optional("ezdxf.path", "drawings").make_path
    vertices: list[list[float]] = []
    try:
        shape = make_path(entity)
        corners = np.array([[at.x, at.y] for at in shape.control_vertices()]).reshape(-1, 2)
        bounded("units from the origin to a shape", np.abs(corners).max(initial=0.0), LARGEST, source, "path")
        extent = np.ptp(corners, axis=0).max() / tolerance if len(corners) else 0.0
        bounded("tolerances along a shape", extent, LONGEST, source, "path")
        for at in shape.flattening(tolerance):
            vertices.append([at.x, at.y])
            bounded("vertices of shapes", next(number), MOST_VERTICES, source, "path")
    except InputError:
        raise
    except (TypeError, ValueError, ArithmeticError):
        vertices = []
    return np.array(vertices).reshape(-1, 2)


def _layers(file: File, drawn: Counter[str], hidden: Counter[str]) -> set[str]:
    """Names of the layers with walls: those that the user names, or those whose names mean walls, or the only layer.

    Args:
        file: drawing; `file.asked["layers"]` has the user's names or None.
        drawn: number of shapes that CAD programs show on each layer.
        hidden: number of shapes that CAD programs do not show on each layer.

    Raises:
        InputError: a named layer is unknown or has only hidden shapes, or the user must name the layers.
    """
    asked = file.asked["layers"]
    if asked is not None:
        if isinstance(asked, str) or not all(isinstance(name, str) for name in asked):
            raise InputError(f"layers must be a list of names, got {asked!r}.", "layers")
        known = {name.lower(): name for name in drawn}
        for name in asked:
            if name.lower() not in known and name.lower() in map(str.lower, hidden):
                raise InputError(f"layers: {name!r} of {str(file.path)!r} has only {NOT_SHOWN}.", "layers")
            choice("layers", name.lower(), list(known))
        return {known[name.lower()] for name in asked}
    named = {name for name in drawn if WALL.search(name)}
    if named or len(drawn) == 1:
        return named or set(drawn)
    told = ", ".join(f"{name} ({number} lines)" for name, number in drawn.most_common(12)) or "none"
    raise InputError(f"layers must name the layers with the walls; {str(file.path)!r} has {told}.", "layers")


def _unit(file: File, code: int, entities: list[Any]) -> str:
    if file.asked["unit"] is not None:
        return choice("unit", file.asked["unit"], list(UNITS))
    if code in CODES:
        return CODES[code]
    number = count(1)
    corners = np.concatenate([_flattened(entity, 1.0, f"path: {str(file.path)!r}", number) for entity in entities])
    size = np.ptp(corners, axis=0)
    told = [f"{name} make {size[0] * per:.3g} x {size[1] * per:.3g} m" for name, per in UNITS.items()]
    raise InputError(
        f"unit must be given, as {str(file.path)!r} states none ($INSUNITS = {code}): {', '.join(told)}.", "unit"
    )
