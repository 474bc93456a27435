"""Checks that memory suffices before it is allocated; a refusal names both figures."""

import os
from pathlib import Path

from lmd.core.checks import InputError

GIB = 2.0**30
LITTLE = 2.0**16  # bytes below which memory is not checked: a check takes a third of a millisecond
MEMINFO = Path("/proc/meminfo")
# Limits of a container in the two versions of Linux control groups.
LIMITS = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))


def free_memory() -> float:
    """Bytes that can be allocated: MemAvailable on Linux, all memory elsewhere; at most the limit of a container."""
    limits = [path.read_text().strip() for path in LIMITS if path.is_file()]
    if MEMINFO.is_file():
        entries = dict(line.split(":") for line in MEMINFO.read_text().splitlines())
        there = 1024.0 * float(entries["MemAvailable"].removesuffix("kB"))
    else:
        there = float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return min([there, *(float(limit) for limit in limits if limit != "max")])


def check_memory(needed: float, what: str, argument: str | None = None) -> None:
    """Raise `InputError` if there is less memory than is needed.

    Args:
        needed: bytes.
        what: subject of the sentence; begins with the argument, if one is the cause.
        argument: name of that argument.
    """
    if needed <= LITTLE:
        return
    free = free_memory()
    if needed > free:
        taken = f"{what} would take {needed / GIB:.4g} GiB of memory"
        raise InputError(f"{taken}, and {free / GIB:.4g} GiB are free.", argument)


def check_views(each: float, positions: int, orientations: int, landmarks: int | None = None) -> None:
    """`check_memory` of data that is kept for every view, a position in an orientation.

    Args:
        each: bytes of a view, or of a landmark in a view.
        positions, orientations: their numbers.
        landmarks: K where something is kept of each landmark in each view, None where it is not.
    """
    what = f"{positions} positions x {orientations} orientations"
    what += "" if landmarks is None else f" x {landmarks} landmarks"
    check_memory(each * positions * orientations * (landmarks or 1), what)
