"""Number of landmarks covered by each axis at each position, as bit sets; shared by coverage and localisation."""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import ALL, ZERO, Integer, add_digit, equal_so_far, unpacked
from lmd.core.compiled import inlined, inner
from lmd.sight.kernels import sum_weights

# Rows of `Counts.sets`.
SHORT = 0  # axes that cover n - 1 landmarks
JUST = 1  # axes that cover n landmarks
ENOUGH = 2  # axes that cover n landmarks or more


class Counts(NamedTuple):
    """Numbers of landmarks covered at Q positions, for W words of axes."""

    digits: np.ndarray
    """`(Q, W, J)` binary digits of the numbers, the lowest first."""
    sets: np.ndarray
    """`(3, Q, W)`: `SHORT`, `JUST`, `ENOUGH`."""


def new_counts(counted_once: np.ndarray, count: int, n: int) -> Counts:
    """Counts before the first landmark of a deployment is counted.

    Args:
        counted_once: axes that cover one landmark outside of the deployment, sets `(Q, W)`.
        count: number K of landmarks that can be counted.
        n: number of landmarks that must be covered.
    """
    digits = np.zeros((*counted_once.shape, max(count + bool(counted_once.any()), n).bit_length()), dtype=np.uint64)
    digits[:, :, 0] = counted_once
    none = np.zeros_like(counted_once)
    just = counted_once if n == 1 else none
    return Counts(digits, np.stack([{1: ~counted_once, 2: counted_once}.get(n, none), just, just]))


@inlined
def enough_with(p: Integer, w: Integer, was: Any, now: Any, counts: Any) -> Any:
    """Axes that cover n landmarks or more, after a move changes the axes that cover one of the landmarks from `was` to
    `now`.
    """
    short, just, enough = counts.sets[SHORT], counts.sets[JUST], counts.sets[ENOUGH]
    return (enough[p, w] & ~(was & ~now & just[p, w])) | (now & ~was & short[p, w])


@inlined
def update_counts(p: Integer, w: Integer, changed: Any, decrement: Any, n: Integer, counts: Any) -> None:
    """Update the counts at the axes `changed`: subtract 1 at the axes in `decrement`, add 1 at the other axes."""
    digits, one, two = counts.digits, ALL, ALL
    short, just, enough = counts.sets[SHORT], counts.sets[JUST], counts.sets[ENOUGH]
    enough[p, w] = enough_with(p, w, changed & decrement, changed & ~decrement, counts)
    for j in range(np.uint64(digits.shape[2])):
        digit, changed = add_digit(digits[p, w, j], changed, decrement)
        digits[p, w, j] = digit
        one, two = equal_so_far(one, digit, n - 1, j), equal_so_far(two, digit, n, j)
    short[p, w], just[p, w] = one, two


@inner
def sum_up(field: Any, state: Any) -> None:
    """Compute quantised P_n at all positions from the counts."""
    units, enough = state.units, state.counts.sets[ENOUGH]
    for p in range(np.uint64(len(units))):
        units[p] = 0
        for w in range(np.uint64(enough.shape[1])):
            units[p] += sum_weights(ZERO, enough[p, w], field.weights, p, w)


def counts_of(state: Any, axes: int) -> np.ndarray:
    """Number of landmarks covered at each position by the first `axes` axes, `(Q, axes)` int16."""
    digits = unpacked(state.counts.digits.transpose(2, 0, 1), axes)
    counts = np.zeros(digits.shape[1:], dtype=np.int16)
    for digit in digits[::-1]:
        counts = 2 * counts + digit
    return counts
