"""Parts of a room in a configuration: obstacles, keep-outs, and the reachable volume."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, TypeVar

import numpy as np

from lmd.core.checks import (
    Checked,
    FloatArray,
    InputError,
    NotNegative,
    Point,
    choice,
    entries,
    span,
    text,
)
from lmd.space.blockers import Body, checked_ring
from lmd.space.surface import Surface

# Units of programs that write rooms, in metres.
UNITS = {"metres": 1.0, "millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254, "feet": 0.3048}
FACES = ("x_min", "x_max", "y_min", "y_max", "bottom", "top")

# Bounds on the longest side of a room, and upper bound on its shortest side, metres; violated if the unit is wrong.
SHORTEST, LONGEST, FLATTEST = 0.3, 1000.0, 200.0

Span = Annotated[Sequence[float], span]
T = TypeVar("T")


def check_metres(size: Iterable[float], makes: str, hint: str, argument: str) -> None:
    """Raise `InputError` if the size of a room is implausible in metres.

    Args:
        size: lengths along x, y and z, metres.
        makes: beginning of the message, the cause, which comes before `a room of 3 x 4 x 2.5 m`.
        hint: end of the message, which states the remedy.
        argument: name of the argument that the error reports.
    """
    lengths = list(size)
    if not SHORTEST <= max(lengths) <= LONGEST or min(lengths) > FLATTEST:
        raise InputError(f"{makes} a room of {box_text(lengths)}; {hint}.", argument)


def box_text(lengths: Iterable[float]) -> str:
    """Text of lengths along x, y and z, metres, for messages."""
    return " x ".join(f"{length:.4g}" for length in lengths) + " m"


def box_surfaces(low: FloatArray, high: FloatArray, names: Sequence[str], inwards: bool = False) -> list[Surface]:
    """Surfaces of the six faces of a box with the corners `low` and `high` `(3,)`, metres, in the order of `FACES`.

    The normals point outwards, or inwards if `inwards` is True. `names` are the names of the surfaces.
    """
    (lx, ly, lz), (ex, ey, ez) = (float(length) for length in high - low), np.eye(3)
    sides = (
        (low, ey, ez, 0.0 - ex, (ly, lz)),
        (low + lx * ex, ey, ez, ex, (ly, lz)),
        (low, ex, ez, 0.0 - ey, (lx, lz)),
        (low + ly * ey, ex, ez, ey, (lx, lz)),
        (low, ex, ey, 0.0 - ez, (lx, ly)),
        (low + lz * ez, ex, ey, ez, (lx, ly)),
    )
    return [
        Surface(name, origin, u, v, 0.0 - normal if inwards else normal, extent)
        for name, (origin, u, v, normal, extent) in zip(names, sides, strict=True)
    ]


@dataclass(frozen=True)
class Obstacle(Checked):
    """Box with sides along x, y and z, such as a rack, that blocks lines of sight and excludes the camera.

    Raises:
        InputError: the box is empty, or the name of a face is unknown.
    """

    low: Point
    """Lower corner, world frame, metres."""
    high: Point
    """Upper corner, world frame, metres."""
    faces: Annotated[Sequence[str], partial(entries, check=partial(choice, options=FACES))] = ()
    """Names, from `FACES`, of the faces that may carry landmarks."""
    name: Annotated[str, text] | None = None
    """Name on drawings, such as `rack`."""

    def _validate(self) -> None:
        if any(a >= b for a, b in zip(self.low, self.high, strict=True)):
            raise InputError(f"low = {list(self.low)} must be below high = {list(self.high)} along x, y and z.", "low")

    @property
    def body(self) -> Body:
        """Convex body that blocks lines of sight."""
        return Body(
            np.vstack([-np.eye(3), np.eye(3)]) + 0.0, np.append(-np.array(self.low), self.high), np.full(6, True)
        )

    def surfaces(self, name: str) -> dict[str, Surface]:
        """Surfaces of the six faces, keyed by the names in `FACES`; each surface is named `<name>_<face>`."""
        names = [f"{name}_{face}" for face in FACES]
        return dict(zip(FACES, box_surfaces(np.array(self.low), np.array(self.high), names), strict=True))

    def corners(self) -> FloatArray:
        """Corners, world frame, metres, `(8, 3)`."""
        return np.stack(np.meshgrid(*zip(self.low, self.high, strict=True), indexing="ij"), axis=-1).reshape(-1, 3)


@dataclass(frozen=True)
class Reachable(Checked):
    """Reachable volume of a floor plan.

    Raises:
        InputError: the heights are in the wrong order, or the clearance is negative.
    """

    height: Span
    """Lowest and highest z of the camera, metres."""
    clearance: NotNegative = 0.0
    """Least distance from the planes of walls, holes and obstacles, metres."""


@dataclass(frozen=True)
class FreeVolume(Checked):
    """Reachable volume of a mesh: between two heights or in a box, with a clearance from triangles.

    Raises:
        InputError: both or neither of `height` and the box are given, bounds are in the wrong order, or the clearance
            is negative.
    """

    height: Span | None = None
    """Lowest and highest z of the camera, metres."""
    low: Point | None = None
    """Lower corner of a box, metres, instead of `height`."""
    high: Point | None = None
    """Upper corner of the box, metres."""
    clearance: NotNegative = 0.0
    """Least distance from all triangles except floor and ceiling, metres."""

    def _validate(self) -> None:
        if (self.height is None) == (self.low is None) or (self.low is None) != (self.high is None):
            raise InputError("height, or low and high in its place, must be given.", "height")
        if self.low and self.high and any(a > b for a, b in zip(self.low, self.high, strict=True)):
            raise InputError(f"low = {list(self.low)} exceeds high = {list(self.high)}.", "low")


def made(name: str, value: Any, kind: type[T]) -> T:
    """Make a part of a room, such as an obstacle, from its value in a configuration.

    A value of the class `kind` is returned unchanged; a mapping has the arguments of `kind`. Messages call the value
    `name`.

    Raises:
        InputError: the value is neither a part nor a mapping, an argument is unknown or missing, or the part is
            invalid.
    """
    if isinstance(value, kind):
        return value
    fields = kind.__dataclass_fields__  # type: ignore[attr-defined]
    if not isinstance(value, Mapping):
        raise InputError(f"{name} must have the keys {', '.join(fields)}, got {value!r}.", name)
    for key in value:
        choice(f"{name} key", key, list(fields))
    try:
        return kind(**value)
    except TypeError:
        raise InputError(f"{name} lacks one of its keys, {', '.join(fields)}: got {value!r}.", name) from None
    except InputError as error:
        raise error.within(name) from None


def all_made(name: str, value: Any, kind: type[T]) -> tuple[T, ...]:
    """Make the parts of a room, such as obstacles, from a list in a configuration; `made` makes each part.

    Raises:
        InputError: the value is not a list, or an entry is invalid, see `made`.
    """
    return entries(name, value, partial(made, kind=kind))


def checked_names(name: str, value: Any, known: Sequence[str]) -> tuple[str, ...]:
    """Check a list of names of surfaces, and return it as a tuple.

    Raises:
        InputError: the list is empty, a name is repeated, or a name is not in `known`.
    """
    given = value if isinstance(value, list | tuple) else ()
    for one in given:
        choice(name, one, known)
    if not given or len(set(given)) != len(given):
        raise InputError(f"{name} must list at least one surface, each once, got {value!r}.", name)
    return tuple(given)


# Keep-outs are measured by hand, so they may reach beyond their surface by this distance, metres.
BEYOND_SURFACE_M = 0.05


@dataclass(frozen=True)
class KeepOut(Checked):
    """Part of a surface that must stay free of landmarks, such as a door, a window or a screen.

    The part is given by distances from the left and the lower edge of its surface. A viewer sees these edges at the
    left and below if the viewer faces a wall with z up, or the floor or ceiling with y up.

    Raises:
        InputError: the part is empty, or is not given in exactly one of two ways: by `from_left` and `from_below`, or
            by `corners`.
    """

    surface: str
    """Name of the surface."""
    from_left: Annotated[Sequence[float], partial(span, point=False)] | None = None
    """Start and end of the part, measured from the left edge of the surface, metres."""
    from_below: Annotated[Sequence[float], partial(span, point=False)] | None = None
    """Start and end of the part, measured from the lower edge of the surface, metres."""
    corners: Annotated[Sequence[Sequence[float]], partial(checked_ring, either_way=True)] | None = None
    """Vertices [from left, from below], metres, instead of both spans."""
    name: Annotated[str, text] | None = None
    """Name on drawings, such as `door`."""

    def _validate(self) -> None:
        if (self.corners is None) == (self.from_left is None) or (self.from_left is None) != (self.from_below is None):
            raise InputError("from_left and from_below, or corners in their place, must be given.", "from_left")

    def check_on(self, name: str, extent: tuple[float, float]) -> None:
        """Raise `InputError` if the keep-out reaches more than `BEYOND_SURFACE_M` beyond its surface.

        Args:
            name: name of the argument with the keep-out, for messages.
            extent: length and width of the surface, metres.
        """
        at = np.array(self.ring)
        beyond = float(max((0.0 - at).max(), (at - extent).max()))
        if beyond > BEYOND_SURFACE_M:
            along, up = extent
            raise InputError(
                f"{name} reaches {beyond:.4g} m beyond {self.surface}, which is {along:.4g} x {up:.4g} m.", name
            )

    @property
    def ring(self) -> FloatArray:
        """Vertices of the part, `(N, 2)`: distances from the left and from the lower edge of its surface, metres."""
        if self.corners is not None:
            return np.array(self.corners)
        assert self.from_left is not None
        assert self.from_below is not None
        (a, c), (b, d) = self.from_left, self.from_below
        return np.array([(a, b), (c, b), (c, d), (a, d)])

    def region(self, face: Surface) -> Any:
        """The part as a shapely polygon in the coordinates (a, b) of its surface `face`, metres."""
        import shapely

        return shapely.Polygon(face.from_left_and_below(self.ring))


def check_surfaces(parts: Sequence[KeepOut], faces: Sequence[str]) -> None:
    """Raise `InputError` if the surface of a keep-out is not one of `faces`."""
    for i, part in enumerate(parts):
        choice(f"keep_out[{i}].surface", part.surface, faces)
