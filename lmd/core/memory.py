"""Checks of free memory before large arrays are allocated; the message of the error names the needed and the free
memory.
"""

import os
from pathlib import Path

from lmd.core.checks import InputError

GIB = 2.0**30
LITTLE = 2.0**16  # smaller allocations are not checked, bytes, as a check takes a third of a millisecond
MEMINFO = Path("/proc/meminfo")
# Files with the memory limit of a container, in versions 2 and 1 of Linux control groups.
LIMITS = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))


def free_memory() -> float:
    """Free memory, bytes: MemAvailable on Linux, the total memory elsewhere; at most the memory limit of a
    container.
    """
    limits = [path.read_text().strip() for path in LIMITS if path.is_file()]
    if MEMINFO.is_file():
        entries = dict(line.split(":") for line in MEMINFO.read_text().splitlines())
        there = 1024.0 * float(entries["MemAvailable"].removesuffix("kB"))
    else:
        there = float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return min([there, *(float(limit) for limit in limits if limit != "max")])


def check_memory(needed: float, what: str, argument: str | None = None) -> None:
    """Raise `InputError` if less memory is free than is needed.

    Args:
        needed: needed memory, bytes; up to `LITTLE` it is not checked.
        what: subject of the message, such as `views = 100`; begins with `argument` if that is given.
        argument: name of the argument that is the cause.
    """
    if needed <= LITTLE:
        return
    free = free_memory()
    if needed > free:
        taken = f"{what} would take {needed / GIB:.4g} GiB of memory"
        raise InputError(f"{taken}, but only {free / GIB:.4g} GiB are free.", argument)


def check_views(each: float, positions: int, orientations: int, landmarks: int | None = None) -> None:
    """Raise `InputError` if too little memory is free for data about every view (position and orientation).

    Args:
        each: memory per view, or per landmark and view, bytes.
        positions, orientations: number of positions and of orientations.
        landmarks: number of landmarks if data is stored for each landmark and view, else None.
    """
    what = f"{positions} positions x {orientations} orientations"
    what += "" if landmarks is None else f" x {landmarks} landmarks"
    check_memory(each * positions * orientations * (landmarks or 1), what)
