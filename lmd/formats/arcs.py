"""Curved walls as flat strips: `CapturedRoom.Surface.Curve` of Apple's RoomPlan."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError, real, vector

# Largest distance of a strip from its arc, metres.
NEAR = 0.01
# Largest distance of the ends of an arc from the ends of its surface if it were flat, or from ends of other walls,
# metres.
JOINED = 0.3
# If the ends for the two signs of angles differ by less than this, metres, the other walls decide between the signs.
ALIKE = 0.05
LARGEST_RADIUS = 1000.0  # largest radius of an arc, metres; arcs of larger radii are refused


@dataclass(frozen=True)
class Arc:
    """Arc in the x-z plane of a surface's own frame, whose y axis points up.

    Apple documents `center` as "xz center coordinates, in local coordinates"; the side to which angles grow is not
    documented.

    Args:
        centre: x and z of the circle's centre, metres; None in files of iOS 16, whose arcs end at z = 0.
        radius: radius, metres.
        start, end: angles of the ends from the x axis, rad.
    """

    centre: tuple[float, float] | None
    radius: float
    start: float
    end: float

    @classmethod
    def of(cls, keys: Mapping[str, Any], name: str) -> "Arc":
        """Arc from the keys of a file.

        Raises:
            InputError: a value is missing or wrong.
        """
        if not isinstance(keys, Mapping) or not {"radius", "startAngle", "endAngle"} <= keys.keys():
            raise InputError(f"{name} must have radius, startAngle and endAngle, got {keys!r}.")
        centre = keys.get("center")
        start, end = (_radians(f"{name}.{key}", keys[key]) for key in ("startAngle", "endAngle"))
        if not 1e-3 < abs(end - start) <= 2.0 * np.pi + 1e-3:
            raise InputError(f"{name}: an arc has more than no angle and at most one turn, got {end - start:.4g} rad.")
        x, z = vector(f"{name}.center", centre, 2) if centre is not None else (0.0, 0.0)
        radius = real(f"{name}.radius", keys["radius"], above=0.0, high=LARGEST_RADIUS)
        return cls(None if centre is None else (x, z), radius, start, end)

    def points(self, side: float) -> FloatArray:
        """Corners `(N, 2)` in x and z of a chain within `NEAR` of the arc, if angles grow towards `side` of z, 1 or -1.

        The chain has the ends of the arc. Its other corners lie outside the arc, such that sectors keep their areas.
        """
        widest = 2.0 * np.arccos(1.0 - min(NEAR / self.radius, 0.5))
        count = int(np.ceil(abs(self.end - self.start) / widest))
        angles, step = np.linspace(self.start, self.end, count + 1, retstep=True)
        reach = np.full(count + 1, self.radius * np.sqrt(step / np.sin(step)))
        reach[[0, -1]] = self.radius
        around = reach[:, None] * np.stack([np.cos(angles), side * np.sin(angles)], axis=1)
        return np.asarray(around + (self.centre if self.centre is not None else -around[[0, -1]].mean(axis=0)))


def strips(arc: Arc, half: FloatArray, others: Sequence[FloatArray], name: str) -> list[FloatArray]:
    """Flat faces `(4, 3)` of a curved surface, in the frame of the surface.

    Angles grow to the side for which the arc ends where the flat surface or another wall ends. If this holds for both
    sides, as for half a circle, the arc bends away from the other walls.

    Args:
        half: half the width and height of the surface, metres.
        others: ends `(2, 3)` of the other walls, in the frame of the surface.
        name: name of the arc, for messages.

    Raises:
        InputError: for neither side does the arc end at such a place.
    """
    ends = np.array([[-half[0], 0.0], [half[0], 0.0], *np.reshape(others, (-1, 3))[:, [0, 2]]])
    chains = [arc.points(side) for side in (1.0, -1.0)]
    off = [_off(chain, ends) for chain in chains]
    if min(off) > JOINED:
        raise InputError(
            f"{name} ends {min(off):.2g} m from the ends of its surface and of every other wall: center, radius and "
            "angles contradict the dimensions; with curve = null it is read as flat."
        )
    if abs(off[0] - off[1]) > ALIKE:
        chosen = chains[int(off[1] < off[0])]
    else:
        middle = ends[2:].mean(axis=0) if len(others) else np.zeros(2)
        chosen = max(chains, key=lambda chain: float(np.linalg.norm(chain.mean(axis=0) - middle)))
    low, high = (np.insert(chosen, 1, y, axis=1) for y in (-half[1], half[1]))
    return [np.array([low[i], low[i + 1], high[i + 1], high[i]]) for i in range(len(chosen) - 1)]


def _off(chain: FloatArray, ends: FloatArray) -> float:
    """Distance of the ends of a chain from two of the `ends` `(N, 2)` at different places; the chain's own ends are
    among them.
    """
    away = np.linalg.norm(chain[[0, -1], None] - ends, axis=-1)
    worse = np.maximum(away[0][:, None], away[1])
    apart = np.linalg.norm(ends[:, None] - ends, axis=-1) > JOINED
    apart[[0, 1], [1, 0]] = True
    return float(worse[apart].min())


def _radians(name: str, value: Any) -> float:
    """Angle, rad, of a Swift `Measurement<UnitAngle>`: a value with the converter to degrees; without a converter the
    value is in degrees.
    """
    factor = 1.0
    if isinstance(value, Mapping):
        unit = value.get("unit")
        converter = unit.get("converter") if isinstance(unit, Mapping) else None
        if isinstance(converter, Mapping):
            factor = real(f"{name}.unit.converter.coefficient", converter.get("coefficient", 1.0), above=0.0)
        value = value.get("value")
    return float(np.deg2rad(factor * real(name, value)))
