"""Parts of a room as a user gives them: obstacles, and where the camera may be."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from lmd.core.checks import FloatArray, InputError, check_fields, choice, real, vector
from lmd.space.blockers import Body
from lmd.space.polygon import checked_ring
from lmd.space.surface import Surface

FACES = ("x_min", "x_max", "y_min", "y_max", "bottom", "top")

# A room whose longest side is not between these, or whose shortest is longer, metres, was not given in metres.
SHORTEST, LONGEST, FLATTEST = 0.3, 1000.0, 200.0

T = TypeVar("T")


def check_metres(size: Iterable[float], makes: str, hint: str, argument: str) -> None:
    """Raise `InputError` if a room of such lengths `(3,)` is none that was given in metres.

    Args:
        size: along x, y and z.
        makes: what made it so, the beginning of the sentence.
        hint: what to do about it, the end of the sentence.
        argument: its name.
    """
    lengths = list(size)
    if not SHORTEST <= max(lengths) <= LONGEST or min(lengths) > FLATTEST:
        raise InputError(f"{makes} a room of {box_text(lengths)}; {hint}.", argument)


def box_text(lengths: Iterable[float]) -> str:
    """Lengths along x, y and z, metres, for messages."""
    return " x ".join(f"{length:.4g}" for length in lengths) + " m"


@dataclass(frozen=True)
class Obstacle:
    """A box with sides along x, y and z, such as a rack. It blocks the line of sight, and no camera can be in it.

    Args:
        low, high: its corners, world frame, metres.
        faces: those of `FACES` that may carry landmarks.
        name: what it is called on paper, such as `rack`.

    Raises:
        InputError: it is empty, or there is no such face.
    """

    low: Sequence[float]
    high: Sequence[float]
    faces: Sequence[str] = ()
    name: str | None = None

    def __post_init__(self) -> None:
        check_fields(self, vector, "low", "high", size=3)
        if any(a >= b for a, b in zip(self.low, self.high, strict=True)):
            raise InputError(f"low = {list(self.low)} must be below high = {list(self.high)} along x, y and z.", "low")
        if isinstance(self.faces, str) or not isinstance(self.faces, Sequence):
            raise InputError(f"faces must be a list, got {self.faces!r}.", "faces")
        for i, face in enumerate(self.faces):
            choice(f"faces[{i}]", face, FACES)
        check_name(self.name)
        object.__setattr__(self, "faces", tuple(self.faces))

    @property
    def body(self) -> Body:
        """The convex body that blocks the line of sight."""
        return Body(
            np.vstack([-np.eye(3), np.eye(3)]) + 0.0, np.append(-np.array(self.low), self.high), np.full(6, True)
        )

    def surfaces(self, name: str) -> dict[str, Surface]:
        """Its faces, by theirs; each is called `<name>_<face>`."""
        low, high = np.array(self.low), np.array(self.high)
        (lx, ly, lz), (ex, ey, ez) = (float(length) for length in high - low), np.eye(3)
        sides = {
            "x_min": (low, ey, ez, 0.0 - ex, (ly, lz)),
            "x_max": (low + lx * ex, ey, ez, ex, (ly, lz)),
            "y_min": (low, ex, ez, 0.0 - ey, (lx, lz)),
            "y_max": (low + ly * ey, ex, ez, ey, (lx, lz)),
            "bottom": (low, ex, ey, 0.0 - ez, (lx, ly)),
            "top": (low + lz * ez, ex, ey, ez, (lx, ly)),
        }
        return {face: Surface(f"{name}_{face}", *sides[face]) for face in FACES}

    def corners(self) -> FloatArray:
        """`(8, 3)`, metres."""
        return np.stack(np.meshgrid(*zip(self.low, self.high, strict=True), indexing="ij"), axis=-1).reshape(-1, 3)


def check_name(name: Any) -> None:
    """Raise `InputError` if what a part is called on paper is no text; None for parts without a name."""
    if name is not None and (not isinstance(name, str) or not name.strip()):
        raise InputError(f"name must be a text, got {name!r}.", "name")


@dataclass(frozen=True)
class Reachable:
    """Where the camera may be.

    Args:
        height: lowest and highest z, metres.
        clearance: from walls, holes and obstacles, metres; around a corner it is that of its edges.

    Raises:
        InputError: the heights are in the wrong order, or the clearance is negative.
    """

    height: Sequence[float]
    clearance: float = 0.0

    def __post_init__(self) -> None:
        low, high = vector("height", self.height, 2)
        if low > high:
            raise InputError(f"height must go from the lowest to the highest, got {[low, high]}.", "height")
        object.__setattr__(self, "height", (low, high))
        check_fields(self, real, "clearance", low=0.0)


@dataclass(frozen=True)
class FreeVolume:
    """Where in a mesh the camera may be: between two heights or in a box, and away from triangles.

    Args:
        height: lowest and highest z, metres; all along x and y.
        low, high: corners of a box in place of that, metres.
        clearance: from every triangle but floor and ceiling, metres.

    Raises:
        InputError: not just one of both is given, they are in the wrong order, or the clearance is negative.
    """

    height: Sequence[float] | None = None
    low: Sequence[float] | None = None
    high: Sequence[float] | None = None
    clearance: float = 0.0

    def __post_init__(self) -> None:
        if (self.height is None) == (self.low is None) or (self.low is None) != (self.high is None):
            raise InputError("height, or low and high in its place, must be given.", "height")
        check_fields(self, real, "clearance", low=0.0)
        if self.height is not None:
            object.__setattr__(self, "height", Reachable(self.height).height)
            return
        check_fields(self, vector, "low", "high", size=3)
        if self.low and self.high and any(a > b for a, b in zip(self.low, self.high, strict=True)):
            raise InputError(f"low = {list(self.low)} exceeds high = {list(self.high)}.", "low")


def made(name: str, kind: type[T], value: Any) -> T:
    """A part of a class from what a user gave: the part itself, or a mapping of its arguments.

    Raises:
        InputError: it is neither, an argument is unknown or missing, or the class refuses it.
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
        raise InputError(f"{name} lacks a key: it has {', '.join(map(str, value)) or 'none'}.", name) from None
    except InputError as error:
        raise error.within(name) from None


def all_made(name: str, kind: type[T], values: Any) -> tuple[T, ...]:
    """A list of such parts."""
    if isinstance(values, str | Mapping) or not isinstance(values, Sequence):
        raise InputError(f"{name} must be a list, got {values!r}.", name)
    return tuple(made(f"{name}[{i}]", kind, value) for i, value in enumerate(values))


def checked_band(value: Any, **bounds: float) -> tuple[float, ...] | None:
    """Lowest and highest z at which landmarks may hang, metres; None for all.

    Raises:
        InputError: it is empty or exceeds `bounds`.
    """
    if value is None:
        return None
    low, high = vector("band", value, 2, **bounds)
    if low >= high:
        raise InputError(f"band must go from the lowest to the highest z, got {[low, high]}.", "band")
    return low, high


def checked_names(name: str, value: Any, known: Sequence[str]) -> tuple[str, ...]:
    """Names of surfaces, each once.

    Raises:
        InputError: there is none, or one is not `known` or repeated.
    """
    given = value if isinstance(value, list | tuple) else ()
    for one in given:
        choice(name, one, known)
    if not given or len(set(given)) != len(given):
        raise InputError(f"{name} must list at least one surface, each once, got {value!r}.", name)
    return tuple(given)


# A keep-out may reach so far beyond its surface, metres: it was measured by hand.
BEYOND_SURFACE_M = 0.05


@dataclass(frozen=True)
class KeepOut:
    """A part of a surface where nothing may hang: a door, a window, a screen.

    It is measured as one stands before the surface: before a wall, above the floor or below the ceiling with y up.

    Args:
        surface: its name.
        from_left: where it begins and ends, from the left edge of the surface, metres.
        from_below: where it begins and ends, from the lower edge of the surface, metres.
        corners: vertices [from left, from below] in place of both.
        name: what it is called on paper, such as `door`.

    Raises:
        InputError: neither both spans nor corners are given, or it is empty.
    """

    surface: str
    from_left: Sequence[float] | None = None
    from_below: Sequence[float] | None = None
    corners: Sequence[Sequence[float]] | None = None
    name: str | None = None

    def __post_init__(self) -> None:
        if (self.corners is None) == (self.from_left is None) or (self.from_left is None) != (self.from_below is None):
            raise InputError("from_left and from_below, or corners in their place, must be given.", "from_left")
        check_name(self.name)
        if self.corners is not None:
            check_fields(self, checked_ring, "corners", either_way=True)
            return
        for name, span in (("from_left", self.from_left), ("from_below", self.from_below)):
            start, stop = vector(name, span, 2)
            if start >= stop:
                raise InputError(f"{name} must go from the lower to the higher, got {[start, stop]}.", name)
            object.__setattr__(self, name, (start, stop))

    def check_on(self, name: str, extent: tuple[float, float]) -> None:
        """Raise `InputError` if it reaches beyond its surface, whose rectangle is `extent`, metres, long and wide.

        Args:
            name: the argument it came from, for messages.
            extent: of the surface.
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
        """Its vertices (from left, from below), `(N, 2)`, metres."""
        if self.corners is not None:
            return np.array(self.corners)
        assert self.from_left is not None
        assert self.from_below is not None
        return _rectangle(*zip(self.from_left, self.from_below, strict=True))

    def region(self, face: Surface) -> Any:
        """The keep-out in the coordinates of its surface, a polygon of shapely."""
        import shapely

        return shapely.Polygon(face.seen(self.ring))


def all_keep_outs(values: Any, faces: Sequence[str]) -> tuple[KeepOut, ...]:
    """Keep-outs from the values that a user gave.

    Args:
        values: list of `KeepOut`s or mappings of their arguments.
        faces: names of the surfaces.

    Raises:
        InputError: a value is no keep-out, or its surface is unknown.
    """
    parts = all_made("keep_out", KeepOut, values)
    for i, part in enumerate(parts):
        choice(f"keep_out[{i}].surface", part.surface, faces)
    return parts


def _rectangle(low: Sequence[float], high: Sequence[float]) -> FloatArray:
    """Its vertices, counter-clockwise, `(4, 2)`."""
    (a, b), (c, d) = low, high
    return np.array([(a, b), (c, b), (c, d), (a, d)])
