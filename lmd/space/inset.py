"""A room as the centres of plates may use it: its surfaces end half a plate before their edges."""

from typing_extensions import override

from lmd.space.changed import Changed
from lmd.space.space import Space
from lmd.space.surface import Surface


class Inset(Changed):
    """A room with other surfaces; those of `surfaces_of`, `surface_near` and `faces` stay the room's, to their edges.

    Args:
        room: the room.
        margin: by which every edge of every surface is moved inwards, metres.

    Raises:
        InputError: a surface has nothing left.
    """

    def __init__(self, room: Space, margin: float) -> None:
        super().__init__(room)
        self._surfaces = tuple(surface.inset(margin) for surface in room.surfaces())

    @override
    def surfaces(self) -> tuple[Surface, ...]:
        """In the order of the room's."""
        return self._surfaces
