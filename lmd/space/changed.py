"""A space that is a room but for what a subclass says otherwise."""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar, cast

from typing_extensions import override

from lmd.space.relevance import Weighing
from lmd.space.space import Space
from lmd.space.surface import Surface

Method = TypeVar("Method", bound=Callable[..., Any])


def _asked(method: Method) -> Method:
    """A method of `Space` by which `Changed` asks its room."""

    @wraps(method)
    def ask(changed: "Changed", *arguments: Any, **named: Any) -> Any:
        return getattr(changed._room, method.__name__)(*arguments, **named)

    return cast(Method, ask)


class Changed:
    """A `lmd.space.space.Space` that asks a room; subclasses answer themselves what they change.

    Args:
        room: the room.
    """

    def __init__(self, room: Space) -> None:
        self._room = room

    @property
    def relevance(self) -> Weighing:
        """See `Space.relevance`."""
        return self._room.relevance

    surfaces = _asked(Space.surfaces)
    surfaces_of = _asked(Space.surfaces_of)
    surface_near = _asked(Space.surface_near)
    bounds = _asked(Space.bounds)
    contains = _asked(Space.contains)
    blockers = _asked(Space.blockers)
    faces = _asked(Space.faces)
    passable = _asked(Space.passable)
    clear = _asked(Space.clear)
    grid = _asked(Space.grid)
    finer = _asked(Space.finer)
    jittered_grid = _asked(Space.jittered_grid)
    sample = _asked(Space.sample)
    sample_evenly = _asked(Space.sample_evenly)
    outline = _asked(Space.outline)
    fixtures = _asked(Space.fixtures)
    describe = _asked(Space.describe)


class Inset(Changed):
    """A room whose surfaces end before their edges, as by half a footprint for the centres of footprints.

    Those of `surfaces_of`, `surface_near` and `faces` stay the room's, to their edges.

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
