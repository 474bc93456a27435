"""Parts of surfaces where nothing may hang, as a user gives them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError, check_fields, choice, vector
from lmd.space.parts import all_made, check_name
from lmd.space.polygon import checked_ring
from lmd.space.surface import Surface

# A keep-out may reach so far beyond its surface, metres: it was measured by hand.
BEYOND_SURFACE_M = 0.05
OLD_KEYS = ("low", "high", "polygon")  # of keep-outs in earlier versions


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


def all_keep_outs(
    values: Any, faces: Sequence[str], seen_before: Callable[[str, FloatArray], FloatArray]
) -> tuple[KeepOut, ...]:
    """A list of keep-outs on surfaces that there are.

    Args:
        values: as the user gave them.
        faces: names of the surfaces.
        seen_before: from a name and places `(N, 2)` as `low`, `high` and `polygon` of earlier versions measured them,
            to those places from the left and from below.

    Raises:
        InputError: one is none, or has keys of earlier versions: the message says what they are now.
    """
    old = []
    for i, value in enumerate(values if isinstance(values, list | tuple) else ()):
        if isinstance(value, Mapping) and any(key in value for key in OLD_KEYS):
            surface = choice(f"keep_out[{i}].surface", value.get("surface"), faces)
            place = _rewritten(f"keep_out[{i}]", value, partial(seen_before, surface))
            old.append(f"{{surface: {surface}, {place}}}")
    if old:
        raise InputError(
            f"keep_out has the keys {', '.join(OLD_KEYS)}, with which earlier versions measured some surfaces from "
            f"their other end; as one stands before them, it is [{', '.join(old)}].",
            "keep_out",
        )
    made = all_made("keep_out", KeepOut, values)
    for i, part in enumerate(made):
        choice(f"keep_out[{i}].surface", part.surface, faces)
    return made


def _rewritten(name: str, old: Mapping[str, Any], seen_before: Callable[[FloatArray], FloatArray]) -> str:
    """The part of a keep-out of earlier versions that says where it is, as it is written now."""
    if "polygon" in old:
        places = seen_before(np.array(checked_ring(f"{name}.polygon", old["polygon"], either_way=True))).round(6)
        return f"corners: [{', '.join(f'[{a:g}, {b:g}]' for a, b in places)}]"
    corners = np.array([vector(f"{name}.{key}", old.get(key), 2) for key in ("low", "high")])
    (left, right), (low, high) = np.sort(seen_before(corners), axis=0).T.round(6)
    return f"from_left: [{left:g}, {right:g}], from_below: [{low:g}, {high:g}]"


def _rectangle(low: Sequence[float], high: Sequence[float]) -> FloatArray:
    """Its vertices, counter-clockwise, `(4, 2)`."""
    (a, b), (c, d) = low, high
    return np.array([(a, b), (c, b), (c, d), (a, d)])
