"""One room of 4 x 3 x 2.5 m in the forms in which headsets and phones keep it, with numbers worked out by hand.

Its floor is around the origin. In the middle of the wall at y = -1.5 is a door of 1 x 2 m, before the opposite one
stands a chest of 1 x 0.5 x 0.8 m. And rooms of RoomPlan's by their walls, of which some are curved.
"""

import math

import numpy as np

HALF = math.sqrt(0.5)


def anchor(label, place, turn, **bounds):
    pose = {"Translation": place, "Rotation": turn, "Scale": [1, 1, 1]}
    return {"SemanticClassifications": [label], "Transform": pose, **bounds}


def plane(width, height):
    return {"PlaneBounds": {"Min": [-width / 2, -height / 2], "Max": [width / 2, height / 2]}}


# Unity: x to the right, y up, z ahead; z of an anchor points out of its plane, degrees about y turn clockwise.
MRUK = {
    "CoordinateSystem": "Unity",
    "Rooms": [
        {
            "Anchors": [
                anchor("FLOOR", [0, 0, 0], [270, 0, 0], PlaneBoundary2D=[[-2, -1.5], [2, -1.5], [2, 1.5], [-2, 1.5]]),
                anchor("CEILING", [0, 2.5, 0], [90, 0, 0], **plane(4, 3)),
                anchor("WALL_FACE", [0, 1.25, 1.5], [0, 180, 0], **plane(4, 2.5)),
                anchor("WALL_FACE", [0, 1.25, -1.5], [0, 0, 0], **plane(4, 2.5)),
                anchor("WALL_FACE", [2, 1.25, 0], [0, 270, 0], **plane(3, 2.5)),
                anchor("WALL_FACE", [-2, 1.25, 0], [0, 90, 0], **plane(3, 2.5)),
                anchor("DOOR_FRAME", [0, 1, -1.49], [0, 0, 0], **plane(1, 2)),
                anchor(
                    "STORAGE",
                    [0, 0.8, 1.25],
                    [270, 0, 0],
                    VolumeBounds={"Min": [-0.5, -0.25, -0.8], "Max": [0.5, 0.25, 0]},
                ),
                anchor("GLOBAL_MESH", [0, 0, 0], [0, 0, 0]),
            ]
        }
    ],
}


def entity(label, place, turn, **bounds):
    orientation, position = dict(zip("xyzw", turn, strict=True)), dict(zip("xyz", place, strict=True))
    return {
        "semanticLabel_META": label,
        "locatable_META": {"orientation": orientation, "position": position},
        **bounds,
    }


def rectangle(width, height):
    offset = {"x": -min(width, 9) / 2, "y": -height / 2}
    return {"bounded2D_META": {"offset": offset, "extent": {"width": width, "height": height}}}


# y up, and rectangles lie in x and z: those of walls stand after a quarter of a turn about x or z.
WEBXR = {
    "spatialEntities": [
        entity("FLOOR", [0, 0, 0], [0, 0, 0, 1], **rectangle(4, 3)),
        entity("CEILING", [0, 2.5, 0], [0, 0, 0, 1], **rectangle(4, 3)),
        entity("WALL_FACE", [0, 1.25, -1.5], [HALF, 0, 0, HALF], **rectangle(4, 2.5)),
        entity("WALL_FACE", [0, 1.25, 1.5], [HALF, 0, 0, HALF], **rectangle(4, 2.5)),
        entity("WALL_FACE", [2, 1.25, 0], [0, 0, HALF, HALF], **rectangle(2.5, 3)),
        entity("WALL_FACE", [-2, 1.25, 0], [0, 0, HALF, HALF], **rectangle(2.5, 3)),
        entity("DOOR_FRAME", [0, 1, 1.49], [HALF, 0, 0, HALF], **rectangle(1, 2)),
        entity(
            "STORAGE",
            [0, 0, -1.25],
            [0, 0, 0, 1],
            bounded3D_META={
                "offset": {"x": -0.5, "y": 0, "z": -0.25},
                "extent": {"width": 1, "height": 0.8, "depth": 0.5},
            },
        ),
        {"semanticLabel_META": "OTHER"},
    ]
}


def surface(place, right, size, **more):
    """A surface of RoomPlan: its pose column by column, x along `right`, y up."""
    up = [0, 1, 0]
    return {"transform": [*right, 0, *up, 0, *np.cross(right, up).tolist(), 0, *place, 1], "dimensions": size, **more}


# y up; no floor was found, and there never is a ceiling.
ROOMPLAN = {
    "version": 2,
    "walls": [
        surface([0, 1.25, -1.5], [1, 0, 0], [4, 2.5, 0]),
        surface([0, 1.25, 1.5], [1, 0, 0], [4, 2.5, 0]),
        surface([2, 1.25, 0], [0, 0, 1], [3, 2.5, 0]),
        surface(
            [-2, 1.25, 0],
            [0, 0, 1],
            [3, 2.5, 0],
            polygonCorners=[[-1.5, -1.25, 0], [1.5, -1.25, 0], [1.5, 1.25, 0], [-1.5, 1.25, 0]],
        ),
    ],
    "doors": [surface([0, 1, 1.5], [1, 0, 0], [1, 2, 0])],
    "objects": [surface([0, 0.4, -1.25], [1, 0, 0], [1, 0.8, 0.5], category={"storage": {}})],
}
ROOMS = {"MRUK": MRUK, "WebXR": WEBXR, "RoomPlan": ROOMPLAN}


def wall(start, end, **more):
    """A wall from one corner to the next, (x, z), 2.5 m high; the room is on its right as seen from above (y up)."""
    (a, b), (c, d) = start, end
    length = math.hypot(c - a, d - b)
    x = [(c - a) / length, 0.0, (d - b) / length]
    z = [-x[2], 0.0, x[0]]
    pose = [*x, 0, 0, 1, 0, 0, *z, 0, (a + c) / 2, 1.25, (b + d) / 2, 1]
    return {"transform": pose, "dimensions": [length, 2.5, 0], **more}


def curve(radius, start, end, center=None, unit=None):
    angles = {"startAngle": {"value": start}, "endAngle": {"value": end}}
    if unit is not None:
        angles = {key: {**value, "unit": {"converter": {"coefficient": unit}}} for key, value in angles.items()}
    return {"radius": radius, **angles, **({} if center is None else {"center": center})}


def room_of_walls(*curves, corners=((0, 0), (6, 0), (6, 4), (0, 4))):
    """A room of 6 x 4 m, some of whose walls, in turn, are curved."""
    ends = [*corners[1:], corners[0]]
    given = [*curves, *[None] * len(corners)]
    return {"walls": [wall(a, b, curve=c) for a, b, c in zip(corners, ends, given, strict=False)]}
