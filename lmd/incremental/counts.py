"""How many landmarks are covered: the counts that coverage and localisation share, of one camera and of a rig."""

from typing import Any, NamedTuple

import numpy as np

from lmd.core.bits import ALL, ZERO, Integer, add_digit, equal_so_far, unpacked
from lmd.core.compiled import inlined, inner
from lmd.sight.kernels import sum_weights

# Rows of `Counts.sets`: the axes that cover
SHORT = 0  # n - 1 landmarks
JUST = 1  # n landmarks
ENOUGH = 2  # n landmarks or more


class Counts(NamedTuple):
    """Landmarks covered from each of Q positions, as W words of axes."""

    digits: np.ndarray
    """`(Q, W, J)` how many, binary digit by binary digit, the lowest first."""
    sets: np.ndarray
    """`(3, Q, W)`: `SHORT`, `JUST`, `ENOUGH`."""


def given_counts(given: np.ndarray, count: int, n: int) -> Counts:
    """Counts with room for `count` landmarks, of which none has come yet.

    Args:
        given: sets of axes `(Q, W)` at which one landmark is covered all the same.
        count: K.
        n: landmarks that must be covered.
    """
    digits = np.zeros((*given.shape, max(count + bool(given.any()), n).bit_length()), dtype=np.uint64)
    digits[:, :, 0] = given
    none = np.zeros_like(given)
    just = given if n == 1 else none
    return Counts(digits, np.stack([{1: ~given, 2: given}.get(n, none), just, just]))


@inlined
def enough_with(p: Integer, w: Integer, was: Any, now: Any, counts: Any) -> Any:
    """The axes that cover n or more once one landmark, which `was` covered at some axes, is covered at others `now`."""
    short, just, enough = counts.sets[SHORT], counts.sets[JUST], counts.sets[ENOUGH]
    return (enough[p, w] & ~(was & ~now & just[p, w])) | (now & ~was & short[p, w])


@inlined
def ripple(p: Integer, w: Integer, changed: Any, decrement: Any, n: Integer, counts: Any) -> None:
    """Count a landmark less at those axes `changed` that are in `decrement`, one more at the others, digit by digit."""
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
    """Find P_n from the counts."""
    units, enough = state.units, state.counts.sets[ENOUGH]
    for p in range(np.uint64(len(units))):
        units[p] = 0
        for w in range(np.uint64(enough.shape[1])):
            units[p] += sum_weights(ZERO, enough[p, w], field.weights, p, w)


def counts_of(state: Any, axes: int) -> np.ndarray:
    """Landmarks covered at each position and each of so many `axes`, `(Q, axes)`."""
    digits = unpacked(state.counts.digits.transpose(2, 0, 1), axes)
    counts = np.zeros(digits.shape[1:], dtype=np.int16)
    for digit in digits[::-1]:
        counts = 2 * counts + digit
    return counts
