"""Captured rooms in which one value is another: each is read or refused in one sentence."""

import copy
import json
from contextlib import suppress

import pytest
from captured import MRUK, ROOMPLAN, WEBXR, curve, room_of_walls

from lmd.core.checks import InputError
from lmd.formats.meshes import read_mesh

# Another type, size or kind, and an integer that no float holds.
OTHERS = (None, True, "", "nan", "\x1b[2J", -1, 0, 1e300, 10**400, [], {}, [[]], [{}], {"a": {}}, [1] * 20)
CURVED = room_of_walls(None, curve(2.0, 0.0, 180.0, [0.0, 0.0], 1.0)) | {"doors": ROOMPLAN["doors"]}
ROOMS = {"MRUK": MRUK, "WebXR": WEBXR, "RoomPlan": ROOMPLAN, "curved": CURVED}


def places(value, path=()):
    """The paths of all values in a document; of a list its first two entries."""
    yield path
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from places(inner, (*path, key))
    elif isinstance(value, list):
        for i, inner in enumerate(value[:2]):
            yield from places(inner, (*path, i))


def replaced(document, path, value):
    if not path:
        return value
    document = copy.deepcopy(document)
    whole = document
    for key in path[:-1]:
        whole = whole[key]
    whole[path[-1]] = value
    return document


@pytest.mark.parametrize("kind", ROOMS)
def test_a_value_that_is_another_is_read_or_refused(kind, tmp_path):
    path = tmp_path / "room.json"
    for place in places(ROOMS[kind]):
        for other in OTHERS:
            path.write_text(json.dumps(replaced(ROOMS[kind], place, other)))
            with suppress(InputError):
                read_mesh(path)


def test_a_room_that_is_nested_deeply_is_refused(tmp_path):
    path = tmp_path / "room.json"
    for text in ("[" * 100_000, '{"walls":' * 100_000, '{"walls": ' + "[" * 500 + "]" * 500 + "}", "1" * 5000):
        path.write_text(text)
        with pytest.raises(InputError):
            read_mesh(path)
