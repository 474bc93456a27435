"""Operations on vectors in compiled code. A vector is a tuple of three numbers; NumPy code that calls these functions
uses tuples of three arrays. Sums are computed from left to right.
"""

from typing import Any, TypeAlias

from lmd.core.bits import Integer
from lmd.core.compiled import inlined

Vector: TypeAlias = tuple[Any, Any, Any]


@inlined
def dot3(a: Vector, b: Vector) -> Any:
    """Inner product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross3(a: Vector, b: Vector) -> Vector:
    """Cross product a x b of two vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def plus3(a: Vector, b: Vector) -> Vector:
    """Sum a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def minus3(a: Vector, b: Vector) -> Vector:
    """Difference a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def times3(factor: Any, a: Vector) -> Vector:
    """Product of a number and a vector."""
    return factor * a[0], factor * a[1], factor * a[2]


@inlined
def in_frame(frame: tuple[Vector, Vector, Vector], a: Vector) -> Vector:
    """Coordinates of a vector along the three axes of a frame."""
    return dot3(frame[0], a), dot3(frame[1], a), dot3(frame[2], a)


@inlined
def row3(rows: Any, i: Integer) -> Vector:
    """Vector in row i of an array `(N, 3)`."""
    return rows[i, 0], rows[i, 1], rows[i, 2]


@inlined
def column3(columns: Any, k: Integer) -> Vector:
    """Vector in the first three rows of column k of an array `(3, N)` or `(6, N)`."""
    return columns[0, k], columns[1, k], columns[2, k]


@inlined
def pair3(columns: Any, k: Integer) -> tuple[Vector, Vector]:
    """Two vectors in column k of an array `(6, N)`, such as position and normal, or optical axis and right vector."""
    return (columns[0, k], columns[1, k], columns[2, k]), (columns[3, k], columns[4, k], columns[5, k])


@inlined
def read3(numbers: Any, first: Integer, step: Integer) -> Vector:
    """Read a vector from an array `(N,)`: the numbers at the indices `first`, `first + step` and `first + 2 step`."""
    # Sums instead of a factor: an unsigned number times a constant is signed; numba tests signed indices for < 0.
    return numbers[first], numbers[first + step], numbers[first + step + step]


@inlined
def write3(numbers: Any, first: Integer, step: Integer, a: Any) -> None:
    """Write the three numbers of a vector into an array `(N,)`, in place. The indices are `first`, `first + step` and
    `first + 2 step`.
    """
    numbers[first], numbers[first + step], numbers[first + step + step] = a


@inlined
def read6(numbers: Any, first: Integer, step: Integer) -> Any:
    """Read the entries xx, xy, xz, yy, yz, zz of a symmetric 3 x 3 matrix from an array `(N,)`. The entries are `step`
    apart, and the first entry is at the index `first`.
    """
    a, b, c = read3(numbers, first, step)
    return a, b, c, *read3(numbers, first + step + step + step, step)


@inlined
def symmetric3(m: Any, a: Vector) -> Vector:
    """Product of a symmetric 3 x 3 matrix `m`, given by its entries xx, xy, xz, yy, yz, zz, and a vector `a`."""
    xx, xy, xz, yy, yz, zz = m
    return dot3((xx, xy, xz), a), dot3((xy, yy, yz), a), dot3((xz, yz, zz), a)


@inlined
def adjugate3(m: Any) -> Any:
    """Adjugate of a symmetric 3 x 3 matrix; both are given by their entries xx, xy, xz, yy, yz, zz."""
    xx, xy, xz, yy, yz, zz = m
    return (
        yy * zz - yz * yz,
        xz * yz - xy * zz,
        xy * yz - xz * yy,
        xx * zz - xz * xz,
        xy * xz - xx * yz,
        xx * yy - xy * xy,
    )


@inlined
def invariants3(m: Any) -> tuple[Any, Any]:
    """Sum of the principal 2 x 2 minors, and determinant, of a symmetric 3 x 3 matrix. The matrix is given by its
    entries xx, xy, xz, yy, yz, zz.
    """
    n = adjugate3(m)
    return n[0] + n[3] + n[5], dot3((m[0], m[1], m[2]), (n[0], n[1], n[2]))
