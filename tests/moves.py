"""The steps of a move, one at a time."""

import numpy as np

from lmd.incremental.field import ACCEPT, BOUND, NO_UNITS, SETTLE, UNDO, perform


def _step(which, field, k, state, scratch, pose=(0.0,) * 6, surface=-1):
    """By `perform`, so that a field is compiled once for all tests; layers share the memory of the scratch."""
    perform(np.array([(which, k, surface, 0)]), np.array([pose]), field, state, _alone(scratch), NO_UNITS)


def _alone(scratch):
    """The scratch as the only one of `layers`."""
    if isinstance(scratch, tuple):
        return type(scratch)(*map(_alone, scratch)) if hasattr(scratch, "_fields") else tuple(map(_alone, scratch))
    return scratch[None]


def bound(field, k, pose, surface, state, scratch):
    _step(BOUND, field, k, state, scratch, pose, surface)


def settle(field, k, state, scratch):
    _step(SETTLE, field, k, state, scratch)


def accept(field, k, state, scratch):
    _step(ACCEPT, field, k, state, scratch)


def undo(field, k, state, scratch):
    _step(UNDO, field, k, state, scratch)


def move(field, k, pose, surface, state, scratch):
    bound(field, k, pose, surface, state, scratch)
    settle(field, k, state, scratch)
    accept(field, k, state, scratch)
