"""Rows of a trajectory in any format, and times for formats without times."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, real, seconds
from lmd.core.tables import read_headless
from lmd.geometry.trajectory import check_order

NANOSECONDS = 1e16  # a greater time is in nanoseconds, as it would be 300 million years in seconds
# Times between `UNCLEAR` and `NANOSECONDS` are no seconds: milliseconds or microseconds since 1970, or nanoseconds
# since the start of the machine.
UNCLEAR = 1e11
# Least sine of the pitch of views that look up or down, and least share of such views that raises a question.
STEEP, NEARLY_ALL = np.cos(np.radians(30.0)), 0.9
FASTEST = 1e-6  # least time between poses, seconds; a shorter time means a wrong unit


@dataclass(frozen=True)
class Rows:
    """Rows of a file.

    Args:
        path: the file, for messages.
        lines: line of each row in the file, from 1.
        time: times, seconds, `(T,)`; increasing after `cleaned`.
        poses: poses of the recorded body, in the frame of the recording, `(T, 4, 4)`.
        frame: frame of the orientations, `optical` or `body`; None if the file does not define it.
        angles: True for angles of a camera, which with a mount are the angles of the body's x axis.
        notes: omissions and assumptions, sentences without a full stop.
    """

    path: str
    lines: Sequence[int]
    time: FloatArray
    poses: FloatArray
    frame: str | None = None
    angles: bool = False
    notes: tuple[str, ...] = ()

    def kept(self, chosen: BoolArray, *notes: str) -> "Rows":
        """Rows selected by `chosen`, with further notes."""
        lines = [line for line, keep in zip(self.lines, chosen, strict=True) if keep]
        return replace(self, lines=lines, time=self.time[chosen], poses=self.poses[chosen], notes=(*self.notes, *notes))


def cleaned(rows: Rows) -> Rows:
    """Rows without repetitions of the previous time, which recorders with a coarse clock write.

    Raises:
        InputError: a time is before the previous time.
    """
    again = np.append(False, np.diff(rows.time) == 0.0)
    if again.any():
        apart = np.linalg.norm(np.diff(rows.poses[:, :3, 3], axis=0), axis=1)[again[1:]].max()
        first = rows.lines[np.flatnonzero(again)[0]]
        rows = rows.kept(
            ~again,
            f"{np.count_nonzero(again)} of {len(again)} poses of {rows.path} have the time of the one before, at most "
            f"{1000.0 * apart:.3g} mm away, and are left out; the first is in line {first}",
        )
    check_order(rows.time, rows.lines)
    return rows


def checked_seconds(source: str, time: FloatArray, scale: float | None, positions: FloatArray | None) -> FloatArray:
    """Times in seconds.

    Args:
        source: the file, for messages.
        time: times in the unit of the file, `(T,)`.
        scale: unit that the file names, in seconds; None if the file names no unit.
        positions: positions at the times, metres, `(T, 3)`; None if unknown.

    Raises:
        InputError: the unit is unclear, or contradicts the unit that the file names.
    """
    latest = float(np.abs(time).max(initial=0.0))
    if scale in (None, 1.0):
        if latest > NANOSECONDS:
            return time / 1e9
        if latest > UNCLEAR:
            raise InputError(
                f"time = {latest:.15g} looks like milliseconds, microseconds or nanoseconds: divide it, or let its "
                "column be called time_ms, time_us or time_ns (in a line above the values such as "
                "'# time_us x y z qx qy qz qw')."
            )
        seconds(source, time, positions)
        return time
    time = time * (scale or 1.0)
    step = float(np.median(np.abs(np.diff(time)))) if len(time) > 1 else 1.0
    if 0.0 < step < FASTEST:
        raise InputError(f"its times cannot be in the unit that it names: poses would be {step:.2g} s apart.")
    seconds(source, time, positions)
    return time


def given_times(count: int, what: str, times: str | None, rate: float | None) -> FloatArray | None:
    """Times `(count,)`, seconds, of poses whose own file has no times; None for times from a `rate`.

    Args:
        what: name of the format without times, for messages.
        times: file with the time of each pose, one per line.
        rate: poses per second, instead of `times`.

    Raises:
        InputError: neither or both of `times` and `rate` are given, or the number of times is not `count`.
    """
    if (times is None) == (rate is None):
        if times is None:
            raise InputError(f"rate (poses a second) or times (a file) must be given: {what} no times.", "rate")
        raise InputError("rate must be left out where times is given.", "rate")
    if rate is not None:
        real("rate", rate, above=0.0)
        return None
    text = read_headless(times, name="times")
    if text is None or text.width != 1:
        raise InputError(f"times: {times} must have one number a line, seconds.", "times")
    time = text.table(["time"]).numbers(["time"])[:, 0]
    if len(time) != count:
        raise InputError(f"times: {times} has {len(time)} times for {count} poses.", "times")
    try:
        return checked_seconds(str(times), time, None, None)
    except InputError as error:
        raise InputError(f"times: {times}: {str(error).removeprefix(f'{times}: ')}", "times") from None


def steep(sines: FloatArray, path: object) -> str:
    """Question if nearly all views look up or down, as they do if body poses are read as camera poses.

    Args:
        sines: sine of the pitch of each view, `(T,)`.
        path: the file, for the question.
    """
    up, down = (float((sign * sines > STEEP).mean()) for sign in (1.0, -1.0))
    if up + down < NEARLY_ALL:
        return ""
    way = "up" if up > down else "down"
    return f"{up + down:.0%} of the views of {path} look straight {way}, within 30 degrees: does the camera?"
