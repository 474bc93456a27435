"""Readable names of surfaces on paper and in pictures: `pillar 1, side 2` for `hole_0_wall_1` in files."""

import re
from collections.abc import Sequence

from lmd.space.fixture import Fixture
from lmd.space.parts import FACES
from lmd.space.surface import Surface

FLAT_FACES = ("bottom", "top")
_FACE = re.compile(rf"obstacle_(\d+)_({'|'.join(FACES)})")
_SIDE_OF_PILLAR = re.compile(r"hole_(\d+)_wall_(\d+)")
_WALL = re.compile(r"wall_(\d+)")


def name_for_people(surface: Surface, fixtures: Sequence[Fixture] = ()) -> str:
    """Name of a surface on paper, such as `pillar 1, side 2` for `hole_0_wall_1`.

    Args:
        surface: a surface of a room.
        fixtures: parts of the room whose names come before a number.

    Returns:
        the name in the room's file for a surface that is not part of a floor plan.
    """
    if found := _SIDE_OF_PILLAR.fullmatch(surface.name):
        return f"pillar {int(found[1]) + 1}, side {int(found[2]) + 1}"
    if found := _WALL.fullmatch(surface.name):
        return f"wall {int(found[1]) + 1}"
    if found := _FACE.fullmatch(surface.name):
        body = next((part.name for part in fixtures if part.has(surface)), f"obstacle {found[1]}")
        return f"{body}, {found[2] if found[2] in FLAT_FACES else f'side {found[2]}'}"
    return surface.name
