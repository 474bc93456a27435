"""Rooms as headsets and phones capture them: rectangles, polygons and boxes with their kinds.

Sources: the scenes of Meta's Immersive Web Emulation Runtime (`spatialEntities`), the scenes that `MRUK` saves in Unity
(`Rooms`, `Anchors`), `CapturedRoom` of Apple's RoomPlan. All these formats have y up, and metres.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, InputError, vector
from lmd.core.files import flat
from lmd.formats.arcs import Arc, strips
from lmd.geometry.se3 import pose_of

if TYPE_CHECKING:
    import shapely

Keys = Mapping[str, Any]
Thing = tuple[str, list[FloatArray]]  # object of a room: its kind, and its faces
JOINED = 0.15  # largest distance between the ends of walls that meet, metres
LEAST_SHARE = 0.5  # least share of the extent of all objects that walls must enclose
HULL = "it has no floor, and its walls do not close: the floor is the convex hull of all that was captured"
# Objects that lie on a wall and exclude landmarks; they add no triangles to the wall.
ON_WALLS = ("door", "door_frame", "window", "window_frame", "opening", "wall_art")
# Kinds that are no objects, or that repeat other objects.
LEFT_OUT = ("global_mesh", "invisible_wall_face", "inner_wall_face")
CURVED = "curved walls are made of flat strips, within 1 cm; those that may bend either way bend away from the room"
# Largest deviation of a matrix in a file from a rotation, as files have few digits.
ROTATION_TOLERANCE = 1e-2
# Corners of each face of a box; the bits of the index of a corner are x, y and z.
BOX = np.array([[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]])


class Part(NamedTuple):
    """Object of a room: flat faces with `(N, 3)` corners each, in the frame of the file."""

    name: str
    faces: tuple[FloatArray, ...]


class Captured(NamedTuple):
    """Objects of a room, and objects on its walls that exclude landmarks."""

    parts: tuple[Part, ...]
    on_walls: tuple[Part, ...]
    note: str = ""


def captured_by(reader: Callable[[Keys], Iterator[Thing]], keys: Keys) -> Captured:
    """Room in the keys and values of a file.

    Args:
        reader: function that returns the objects of the room with their kinds and faces.

    Raises:
        InputError: there are several rooms, or a value is wrong.
    """
    try:
        found = list(reader(keys))
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"the key or value {' '.join(str(error).split())} is missing or wrong.") from None
    counts: Counter[str] = Counter()
    parts: list[Part] = []
    notes: list[str] = []
    for name, faces in found:
        parts.append(Part(f"{name}_{counts[name]}", tuple(faces)))
        counts[name] += 1
    if "floor_0" not in (part.name for part in parts):
        outline, is_sure = floor_below([(part.name, face) for part in parts for face in part.faces])
        parts.append(Part("floor_0", (outline,)))
        notes += [] if is_sure else [HULL]
    on_walls = [part for part in parts if part.name.rpartition("_")[0] in ON_WALLS]
    if any(thing.get("curve") for thing in keys.get("walls") or ()):
        notes.append(CURVED)
    return Captured(tuple(part for part in parts if part not in on_walls), tuple(on_walls), "; ".join(notes))


def cut(face: FloatArray) -> FloatArray:
    """Cut a flat polygon `(N, 3)` into triangles `(T, 3, 3)`; none if the polygon crosses itself or has no area."""
    import shapely

    _, _, (right, up, _) = np.linalg.svd(face - face.mean(axis=0))
    flat = shapely.Polygon((face - face.mean(axis=0)) @ np.stack([right, up], axis=1))
    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(flat)) if flat.is_valid else []
    corners = [shapely.get_coordinates(part)[:3] @ np.stack([right, up]) + face.mean(axis=0) for part in parts]
    return np.array(corners).reshape(-1, 3, 3)


def _rectangle(low: Any, high: Any) -> FloatArray:
    (a, b), (c, d) = vector("corner", low, 2), vector("corner", high, 2)
    return np.array([[a, b, 0.0], [c, b, 0.0], [c, d, 0.0], [a, d, 0.0]])


def _box(low: Any, high: Any) -> list[FloatArray]:
    ends = np.array([vector("corner", low, 3), vector("corner", high, 3)])
    corners = np.array([[ends[i >> axis & 1, axis] for axis in range(3)] for i in range(8)])
    return [corners[face] for face in BOX]


def _placed(pose: FloatArray, faces: list[FloatArray]) -> list[FloatArray]:
    return [face @ pose[:3, :3].T + pose[:3, 3] for face in faces]


def _xyz(keys: Keys, names: str = "xyz") -> list[Any]:
    return [keys[name] for name in names]


def webxr(keys: Keys) -> Iterator[Thing]:
    """Objects of a WebXR scene: poses by quaternions; boxes and rectangles, which lie in x and z, by a corner and an
    extent.
    """
    from scipy.spatial.transform import Rotation

    for thing in keys["spatialEntities"]:
        label = str(thing.get("semanticLabel_META", "other")).lower()
        if label in LEFT_OUT or "locatable_META" not in thing:
            continue
        place = thing["locatable_META"]
        turn = Rotation.from_quat(vector("orientation", _xyz(place["orientation"], "xyzw"), 4)).as_matrix()
        pose = pose_of(turn, np.array(vector("position", _xyz(place["position"]), 3)))
        if "bounded3D_META" in thing:
            bounds = thing["bounded3D_META"]
            low = np.array(vector("offset", _xyz(bounds["offset"]), 3))
            size = vector("extent", [bounds["extent"][name] for name in ("width", "height", "depth")], 3)
            yield label, _placed(pose, _box(low, low + size))
        elif "bounded2D_META" in thing:
            bounds = thing["bounded2D_META"]
            low = np.array(vector("offset", _xyz(bounds["offset"], "xy"), 2))
            size = vector("extent", [bounds["extent"][name] for name in ("width", "height")], 2)
            yield label, _placed(pose, [_rectangle(low, low + size)[:, [0, 2, 1]]])


def mruk(keys: Keys) -> Iterator[Thing]:
    """Objects of a scene of Unity, whose frame is left-handed (z ahead); rotations are in degrees about y, then x, then
    z.
    """
    from scipy.spatial.transform import Rotation

    system, rooms = keys.get("CoordinateSystem"), keys["Rooms"]
    if system != "Unity":
        raise InputError(f"CoordinateSystem must be Unity, got {system!r}: save the scene by MRUK in Unity.")
    if len(rooms) != 1:
        raise InputError(f"it has {len(rooms)} rooms: leave one of them in the file.")
    for thing in rooms[0]["Anchors"]:
        label = str([*thing.get("SemanticClassifications", ()), "OTHER"][0]).lower()
        if label in LEFT_OUT:
            continue
        place = thing["Transform"]
        x, y, z = vector("Rotation", place["Rotation"], 3)
        turn = Rotation.from_euler("YXZ", [y, x, z], degrees=True).as_matrix()
        pose = pose_of(turn, np.array(vector("Translation", place["Translation"], 3)))
        if "VolumeBounds" in thing:
            faces = _box(thing["VolumeBounds"]["Min"], thing["VolumeBounds"]["Max"])
        elif "PlaneBoundary2D" in thing:
            if len(ring := thing["PlaneBoundary2D"]) < 3:
                raise InputError(f"PlaneBoundary2D must have at least three corners, got {len(ring)}.")
            faces = [np.array([[*vector("PlaneBoundary2D", at, 2), 0.0] for at in ring])]
        elif "PlaneBounds" in thing:
            faces = [_rectangle(thing["PlaneBounds"]["Min"], thing["PlaneBounds"]["Max"])]
        else:
            continue
        yield label, [face * [1.0, 1.0, -1.0] for face in _placed(pose, faces)]


def roomplan(keys: Keys) -> Iterator[Thing]:
    """Objects of RoomPlan: poses are column by column, surfaces lie in their plane z = 0 or along an arc, boxes are
    centred.
    """
    ends = [
        _placed(pose, [half * [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]])[0] for _, pose, half in _surfaces(keys, "walls")
    ]
    for kind in ("walls", "doors", "windows", "openings", "floors", "objects"):
        for i, (thing, pose, half) in enumerate(_surfaces(keys, kind)):
            if kind == "objects":
                category = thing.get("category", "object")
                label = next(iter(category), "object") if isinstance(category, Mapping) else str(category)
                yield label.lower(), _placed(pose, _box(-half, half))
            elif curve := thing.get("curve"):
                others = [(at - pose[:3, 3]) @ pose[:3, :3] for j, at in enumerate(ends) if (kind, j) != ("walls", i)]
                arc = Arc.of(curve, f"{kind}[{i}].curve")
                yield kind[:-1], _placed(pose, strips(arc, half[:2], others, f"{kind}[{i}].curve"))
            elif len(ring := thing.get("polygonCorners") or ()) > 2:
                yield kind[:-1], _placed(pose, [np.array([vector("polygonCorners", at, 3) for at in ring])])
            else:
                yield kind[:-1], _placed(pose, [_rectangle(-half[:2], half[:2])])


def _surfaces(keys: Keys, kind: str) -> Iterator[tuple[Keys, FloatArray, FloatArray]]:
    """Objects of a kind in a file of RoomPlan, with the pose and half the size `(3,)` of each."""
    for i, thing in enumerate(keys.get(kind) or ()):
        pose = np.array(vector("transform", flat(thing["transform"]), 16)).reshape(4, 4).T
        turn = pose[:3, :3]
        if (pose[3] != [0.0, 0.0, 0.0, 1.0]).any() or np.abs(turn.T @ turn - np.eye(3)).max() > ROTATION_TOLERANCE:
            raise InputError(f"{kind}[{i}].transform is no rotation and translation, written column by column.")
        yield thing, pose, np.array(vector("dimensions", thing["dimensions"], 3)) / 2.0


def floor_below(faces: Sequence[tuple[str, FloatArray]]) -> tuple[FloatArray, bool]:
    """Outline `(N, 3)` of a floor below faces `(n, 3)`, y up; and True if walls enclose the floor.

    If walls do not close, the outline is the convex hull of all faces.

    Args:
        faces: faces with the kinds of their objects.

    Raises:
        InputError: no face extends over an area.
    """
    import shapely

    corners = np.concatenate([face for _, face in faces] or [np.zeros((0, 3))])
    hull = shapely.MultiPoint(corners[:, [0, 2]]).convex_hull
    if hull.geom_type != "Polygon":
        raise InputError("it has neither a floor nor walls.")
    walls = np.array([_ends(face) for name, face in faces if name.startswith("wall")]).reshape(-1, 2)
    closed = _enclosed(walls)
    if closed is None or closed.area < LEAST_SHARE * hull.area:
        closed, is_sure = hull, False
    else:
        is_sure = True
    ring = shapely.get_coordinates(closed.exterior)[:-1]
    return np.insert(ring, 1, corners[:, 1].min(), axis=1), is_sure


def _ends(face: FloatArray) -> FloatArray:
    """Ends of a wall seen from above, `(2, 2)`: the two corners that are farthest apart."""
    flat = face[:, [0, 2]]
    away = np.linalg.norm(flat[:, None] - flat, axis=-1)
    return np.asarray(flat[list(np.unravel_index(np.argmax(away), away.shape))])


def _enclosed(ends: FloatArray) -> "shapely.Polygon | None":
    """Largest polygon that n walls with `ends` `(2 n, 2)` enclose; None if they enclose no polygon."""
    import shapely

    if not len(ends):
        return None
    joined = np.linalg.norm(ends[:, None] - ends, axis=-1) < JOINED
    middles = (joined[..., None] * ends).sum(axis=1) / joined.sum(axis=1)[:, None]
    first = np.argmax(joined, axis=1)  # ends that meet get the index of the first of them
    lines = shapely.linestrings(middles[first].reshape(-1, 2, 2))
    areas = shapely.get_parts(shapely.polygonize(shapely.get_parts(shapely.union_all(lines))))
    return max(areas, key=lambda polygon: polygon.area, default=None)
