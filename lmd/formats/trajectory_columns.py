"""Columns of a trajectory by their names in other programs, with units."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.core.tables import Table
from lmd.geometry.se3 import ROW

POSITION, QUATERNION = ROW[:3], ROW[3:]
EULER = ("roll", "pitch", "yaw")  # angles of a body in ROS's convention: x ahead, y left, z up
# Angles of a camera, as in `lmd.geometry.frames.rotation`: clockwise from the y axis, up, and to the left.
OWN_ANGLES = ("yaw_from_y", "pitch_up", "roll_left")
OWN_HEADER = ("time", *POSITION, "yaw", "pitch")  # header with the old names of a camera's angles
LONGEST_NAME = 80  # greatest number of characters of a column's name that are searched
NEEDED = "time, x, y, z and qx, qy, qz, qw"

_SECONDS = {
    **dict.fromkeys(("sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("msec", "msecs", "millis", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("usec", "usecs", "micros", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("nsec", "nsecs", "nanos", "nanosec", "nanosecs", "nanosecond", "nanoseconds"), 1e-9),
}
_METRES = {"m": 1.0, "metre": 1.0, "metres": 1.0, "meter": 1.0, "meters": 1.0, "cm": 1e-2, "mm": 1e-3}
_RADIANS = {"rad": 1.0, "radian": 1.0, "radians": 1.0}
_DEGREES = dict.fromkeys(("deg", "degree", "degrees", "°"), np.pi / 180.0)
# Units in seconds, metres or radians, by the kind of column in `_PATTERNS`.
UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, **_SECONDS},
    "place": _METRES,
    "angle": {**_RADIANS, **_DEGREES},
}


def _one_of(words: Sequence[str]) -> str:
    return "|".join(sorted(words, key=len, reverse=True))


_CLOCKS = "bag|elapsed|epoch|gps|log|rel|relative|ros|rosbag|sim|sys|system|unix|utc|wall"
_PATTERNS = {
    "time": (
        rf"(?:(?:.*[./ ])?(?:(?:{_CLOCKS})[_ ]?)?(?:time(?:[_ ]?stamp)?s?|stamps?)|ts?|utime)"
        rf"(?:[_./ ]?(?P<unit>{_one_of(list(UNITS['time']))}))?",
        rf"(?P<unit>{_one_of(list(_SECONDS))})",
    ),
    # EuRoC and OKVIS write frames between the letter and the axis: RS in R, or WS in W.
    "place": (
        r"(?:(?:p|t|pos|(?:.*[._/ ])?(?:position|translation))[._/ ]?)?(?:(?:rs_r|ws_w)_)?(?P<axis>[xyz])"
        rf"(?:_(?P<unit>{_one_of(list(_METRES))}))?",
    ),
    "turn": (
        r"(?:q|quat|quaternion|ori|rot|(?:.*[._/ ])?(?:orientation|rotation|quaternion))[._/ ]?(?:q[._/ ])?"
        r"(?:rs_|ws_)?(?P<axis>[wxyz])",
    ),
    "angle": (rf"(?:.*[./ ])?(?P<axis>roll|pitch|yaw)(?:[_ ](?P<unit>{_one_of(list(UNITS['angle']))}))?",),
    "own": (rf"(?P<axis>{'|'.join(OWN_ANGLES)})",),
}
_COMPILED = [(kind, re.compile(text)) for kind, texts in _PATTERNS.items() for text in texts]
_BRACKETS = re.compile(r"[\[(]([^\[(\])]*)[\])]$")
# Names of a quaternion with w first: qw qx qy qz, (w, x, y, z), wxyz, w i j k.
_W_FIRST = re.compile(r"(?<![a-z])q?_?w[\W_]*q?_?x[\W_]*q?_?y[\W_]*q?_?z|(?<![a-z])w[\W_]+i[\W_]+j[\W_]+k(?![a-z])")


@dataclass(frozen=True)
class Column:
    """Known column.

    Args:
        name: name in the file.
        kind: `time`, `place`, `turn`, `angle` or `own`, one of `OWN_ANGLES`.
        unit: unit in the name, in small letters; empty if the name has none.
    """

    name: str
    kind: str
    unit: str

    @property
    def scale(self) -> float:
        """Unit of the column in seconds, metres or radians.

        Raises:
            InputError: the unit is unknown.
        """
        units = UNITS.get(self.kind)
        if not self.unit or units is None:
            return 1.0
        if self.unit not in units:
            raise InputError(
                f"the unit {self.unit!r} of the column {self.name!r} is not known, only {', '.join(units)}."
            )
        return units[self.unit]


def known_column(name: str) -> tuple[str, Column] | None:
    """Standard name of a column, and the column; None for an unknown name."""
    plain = name.strip().strip("'\"").lstrip("#%_ \t").lower()
    unit = ""
    # Digits in brackets count the columns of an array, in any order: q[0].
    if (brackets := _BRACKETS.search(plain)) is not None and not brackets[1].strip().isdigit():
        unit, plain = brackets[1].strip(), plain[: brackets.start()].rstrip()
    for kind, pattern in _COMPILED:
        if (found := pattern.fullmatch(plain)) is not None:
            groups = found.groupdict()
            unit = unit or groups.get("unit") or ("us" if plain == "utime" else "")
            axis = groups.get("axis")
            own = "time" if axis is None else f"q{axis}" if kind == "turn" else axis
            return own, Column(name, kind, "" if unit in ("-", "1") else unit)
    return None


def known_columns(names: Sequence[str]) -> dict[str, Column]:
    """Known columns by their standard names; of several columns of times, the first is taken.

    Raises:
        InputError: two columns may hold one quantity.
    """
    found: dict[str, Column] = {}
    for name in names:
        if (known := known_column(name)) is None or (known[0] == "time" and "time" in found):
            continue
        own, column = known
        if own in found:
            raise InputError(f"its columns {found[own].name!r} and {name!r} may both be {own}: leave one.")
        found[own] = column
    return found


def check_quaternion_order(comments: Sequence[str]) -> None:
    """Raise `InputError` if a comment that does not name the columns has a quaternion with w first."""
    for comment in comments:
        if _W_FIRST.search(comment.lower()):
            raise InputError(
                f"a comment, {comment.strip()[:120]!r}, has w before x, y, z, and does not name the columns: write a "
                "line above the values that names each, such as '# time x y z qw qx qy qz' (or id for time, of tags)."
            )


def is_header(words: Sequence[str]) -> bool:
    """True if the words of a comment name columns: two words are known, or most words do not look like a sentence."""
    if sum(known_column(word) is not None for word in words) >= 2:
        return True
    return 2 * sum(len(word) <= 3 or not word.isalpha() for word in words) >= len(words)


def values(table: Table, columns: Mapping[str, Column], names: Sequence[str]) -> FloatArray:
    """Values of the columns `names`, in seconds, metres and radians, `(rows, len(names))`."""
    rows = table.numbers([columns[name].name for name in names], None)
    return rows * [columns[name].scale for name in names]


def lacking(table: Table, columns: Mapping[str, Column]) -> InputError:
    """Error about a table that is no trajectory; the message names the missing columns."""
    said = ", ".join(table.texts)[:300]
    if "time" not in columns:
        return InputError(
            f"it has no column with a name that is known as the time, such as time or stamp_ns: its columns are {said}."
        )
    if arrays := [
        name for name in table.texts if re.search(r"(q|quat\w*|orientation)\[?0\]?$", name.lower()[-LONGEST_NAME:])
    ]:
        return InputError(
            f"its columns from {arrays[0]!r} on do not say which is w: call them qx, qy, qz, qw (PX4 has w first, axes "
            "that point north, east and down, and microseconds: take time_us,x,y,z,qw,qx,qy,qz from timestamp, "
            "position[0], -position[1], -position[2], q[0], q[1], -q[2], -q[3], and frame=body)."
        )
    turns = EULER if any(name in columns for name in EULER) and "qw" not in columns else QUATERNION
    missing = [name for name in (*POSITION, *turns) if name not in columns]
    plane = (
        " Of a motion in the plane add z, the height, and roll = pitch = 0 beside yaw (of a body, counter-clockwise "
        "from x, radians): time,x,y,z,roll,pitch,yaw."
    )
    return InputError(
        f"it lacks {', '.join(missing)}: a pose has {NEEDED} (or roll, pitch, yaw), and its columns are {said}."
        + (plane if {"x", "y"} <= columns.keys() and "z" not in columns else "")
    )
