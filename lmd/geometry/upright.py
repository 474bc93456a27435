"""The frame of a square that hangs upright, as a scalar function for kernels; `lmd.tag.upright` is the reference."""

import math

from lmd.compiled import inlined


@inlined
def upright_axes(nx, ny, nz, level):  # type: ignore[no-untyped-def]
    """Right and up of an upright square with the unit normal (nx, ny, nz); `level`: see `lmd.tag.LEVEL`."""
    across = nx * nx + ny * ny
    on_wall = across > level * level
    square = across if on_wall else nx * nx + nz * nz
    length = math.sqrt(square)
    tx, ty, tz = (
        (-ny if on_wall else nz) / length,
        (nx if on_wall else 0.0) / length,
        (0.0 if on_wall else -nx) / length,
    )
    ux, uy = -(nx * (nz if on_wall else ny)) / length, (-(ny * nz) if on_wall else square) / length
    uz = (square if on_wall else -(ny * nz)) / length
    return tx, ty, tz, ux, uy, uz
