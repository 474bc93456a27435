"""Texts with a tag in each line, without a header: the meaning of values follows from a comment, or from their number.

Sources: `ArucoMap::addMarker` of CopterExpress/clover; `Map::saveMap` of UbiquityRobotics/fiducials; `Marker/Priors`
of RTAB-Map, and the poses that it exports.
"""

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.core.tables import COMMENT, Table, is_number
from lmd.formats.landmark_table import ANGLES, PLACE, QUATERNION, named_columns
from lmd.formats.placed_tag import (
    LARGEST_EDGE,
    NUMBERS,
    SMALLEST_EDGE,
    Found,
    PlacedTag,
    edge_of,
    number_of,
    turn_by_angles,
    turn_by_quaternion,
)
from lmd.formats.trajectory_columns import check_quaternion_order
from lmd.geometry.frames import roll_pitch_yaw
from lmd.geometry.se3 import QUATERNION_TOLERANCE
from lmd.scene.edges import EDGE
from lmd.scene.families import family_named
from lmd.scene.labels import ID

CLOVER = (ID, EDGE, *PLACE, "yaw", "pitch", "roll")
# Names of the angles in Clover's generator of maps.
CLOVER_ANGLES = {"rot_z": "yaw", "rot_y": "pitch", "rot_x": "roll"}
CLOVER_LEAST = 4  # least number of values; values after y may be missing
BY_ANGLES, BY_QUATERNION = (ID, *PLACE, *ANGLES), (ID, *PLACE, *QUATERNION)
FIDUCIAL_SLAM = (ID, *PLACE, *ANGLES, "variance", "observations")  # then the numbers of tags seen with the tag
RTABMAP_POSES = ("timestamp", *PLACE, *QUATERNION, ID)
PRIORS = re.compile(r"^[ \t]*Marker[\\/]Priors\s*=(.*)$", re.MULTILINE)
SETTING = r"^[ \t]*Marker[\\/]{}\s*=\s*\"?(\S+?)\"?\s*$"  # line of RTAB-Map's configuration
SAME_AS_ONE = 0.999  # least largest component of a quaternion for no turn, or a half turn about an axis
FEW = 2  # least number of tags per size in a map whose column may not be sizes


class Line(NamedTuple):
    """Values of a line.

    Args:
        number: number of the line in its file, from 1.
        texts: texts of the values.
    """

    number: int
    texts: list[str]

    def values(self, names: Sequence[str]) -> FloatArray:
        """Values after the first, as finite numbers.

        Args:
            names: names of all values, for messages.

        Raises:
            InputError: a value is no finite number, or the numbers of values and names differ.
        """
        if len(self.texts) != len(names):
            raise InputError(f"line {self.number}, {' '.join(self.texts)!r}, must be: {' '.join(names)}.")
        try:
            values = np.array([float(text) for text in self.texts[1:]])
        except ValueError as error:
            raise InputError(f"line {self.number}: {error}.") from None
        if not np.isfinite(values).all():
            raise InputError(f"line {self.number}, {' '.join(self.texts)!r}, has a value that is not finite.")
        return values

    @property
    def id(self) -> int:
        """Number of the tag, which is the first value."""
        if not re.fullmatch(r"\d{1,15}", self.texts[0]):
            raise InputError(f"line {self.number}: the id must be a whole number from 0, got {self.texts[0][:80]!r}.")
        return number_of(int(self.texts[0]))


def lines_of(text: str) -> tuple[list[str], list[Line]]:
    """Comments above the first values, without #; and the lines with values, without trailing comments."""
    comments, lines = list[str](), list[Line]()
    for number, line in enumerate(text.splitlines(), 1):
        values, _, comment = line.partition(COMMENT)
        if texts := values.replace(",", " ").split():
            lines.append(Line(number, texts))
        elif comment.strip() and not lines:
            comments.append(comment.strip())
    return comments, lines


def read_lines(path: Any, text: str) -> Found:
    """Tags of a text whose first value is a number.

    Raises:
        InputError: the text has no header, and its values are ambiguous.
    """
    comments, lines = lines_of(text)
    names = _named(comments, lines)
    if names is not None and names[0] == RTABMAP_POSES[0] and ID in names:
        return Found(
            _rtabmap_poses(lines, names), None, True, f"{path}: its tags are the poses of RTAB-Map with a negative id"
        )
    if names is not None and names != list(CLOVER[: len(names)]):
        for line in lines:
            if len(line.texts) != len(names):
                raise InputError(
                    f"line {line.number} has {len(line.texts)} values, but a comment names {len(names)}: "
                    f"{' '.join(names)}."
                )
        return Found([], _table(path, lines, names))
    if names is None and "," in text.splitlines()[lines[0].number - 1]:
        raise InputError(
            "it has no header: its first line must name the columns, such as id,x,y,z,qx,qy,qz,qw or "
            "id,x,y,z,nx,ny,nz (docs/mounting.md)."
        )
    if names is not None:
        return Found([_clover(line) for line in lines], by_opencv=True)
    check_quaternion_order(comments)
    return _by_number(path, lines)


def _named(comments: Sequence[str], lines: Sequence[Line]) -> list[str] | None:
    """Names of the values from a comment above them; None if no comment names them.

    A comment names the values if it has as many words as the lines have values and two known words, or if the comment
    begins with as many known words.
    """
    width = max(len(line.texts) for line in lines)
    for comment in comments:
        plain = re.sub(r"(?<!\s)\s*[\[(][^\[(\])]*[\])]", lambda found: found[0].replace(" ", ""), comment)
        words = [word.strip(":;") for word in re.split(r"[,\s]+", plain) if word.strip(":;")]
        names = named_columns([CLOVER_ANGLES.get(word.lower(), word) for word in words])
        known = [name in (*CLOVER, *QUATERNION, RTABMAP_POSES[0], "variance") for name in names]
        leading = known.index(False) if False in known else len(known)
        if len(names) == width and sum(known) >= 2:
            return names
        if leading >= CLOVER_LEAST and names[0] in (ID, RTABMAP_POSES[0]):
            return names[:leading]
    return None


def _by_number(path: Any, lines: list[Line]) -> Found:
    """Tags of lines without names, from the number of values and their possible meanings."""
    widths = {len(line.texts) for line in lines}
    most, count = max(widths), len(lines[0].texts)
    if count > len(FIDUCIAL_SLAM) or (count == len(FIDUCIAL_SLAM) and not _are_quaternions(lines, widths)):
        if odd := [line for line in lines if not _may_be_fiducial_slam(line)]:
            raise _question(odd[0], f"it has {len(odd[0].texts)} values, and they are not those of fiducial_slam")
        return Found(
            [_fiducial_slam(line) for line in lines], None, True, _note(path, FIDUCIAL_SLAM, "fiducial_slam's")
        )
    if count < CLOVER_LEAST or most > len(CLOVER):
        raise _question(lines[0], "its lines have no names")
    if len(widths) == 1 and most == len(BY_ANGLES):
        return _angles(path, lines)
    if len(widths) == 1 and most == len(BY_QUATERNION) and _are_quaternions(lines, widths):
        return _quaternions(path, lines)
    edges = [line.values(CLOVER[: len(line.texts)])[0] for line in lines]
    if odd := [edge for edge in edges if not SMALLEST_EDGE <= edge <= LARGEST_EDGE]:
        raise _question(lines[edges.index(odd[0])], f"an edge of {odd[0]:g} m would be none of a tag")
    if most < len(BY_ANGLES) and len(set(edges)) > max(1, len(edges) // FEW):
        raise _question(lines[0], "nearly every tag would have an edge of its own")
    return Found([_clover(line) for line in lines], None, True, _note(path, CLOVER[:most], "Clover's"))


def _angles(path: Any, lines: list[Line]) -> Found:
    """Read lines of seven values. A single line is a tag of RTAB-Map; several lines have angles, and are refused if
    they may as well be Clover's without the roll.
    """
    if len(lines) == 1:
        return Found([_by_angles(lines[0])], None, True, _note(path, BY_ANGLES, "RTAB-Map's"))
    edges = [line.values(CLOVER[: len(BY_ANGLES)])[0] for line in lines]
    if all(SMALLEST_EDGE <= edge <= LARGEST_EDGE for edge in edges):
        raise _question(lines[0], f"it may be {' '.join(BY_ANGLES)}, or Clover's {' '.join(CLOVER[:-1])}")
    return Found([], _table(path, lines, BY_ANGLES))


def _quaternions(path: Any, lines: list[Line]) -> Found:
    """Tags of lines of eight values, the last four of length one: quaternions, unless they may be Clover's z and
    angles.
    """
    values = np.array([line.values(BY_QUATERNION) for line in lines])
    is_edge = ((values[:, 0] >= SMALLEST_EDGE) & (values[:, 0] <= LARGEST_EDGE)).all()
    turns = np.abs(values[:, 3:])
    plain = (turns.max(axis=1) > SAME_AS_ONE).all()  # 1, 0, 0, 0 in any order may also be z = 1 without a turn
    if plain and is_edge and not (turns[:, 3] > SAME_AS_ONE).all():
        if (turns[:, 0] > SAME_AS_ONE).all():
            return Found([_clover(line) for line in lines], None, True, _note(path, CLOVER, "Clover's"))
        raise _question(lines[0], f"it may be {' '.join(BY_QUATERNION)}, or Clover's {' '.join(CLOVER)}")
    return Found([], _table(path, lines, BY_QUATERNION))


def _are_quaternions(lines: Sequence[Line], widths: set[int]) -> bool:
    """True if all lines have equal numbers of values, and the last four values have length one."""
    if len(widths) > 1:
        return False
    try:
        last = np.array([[float(text) for text in line.texts[-4:]] for line in lines])
    except ValueError:
        return False
    return bool((np.abs(np.linalg.norm(last, axis=1) - 1.0) <= QUATERNION_TOLERANCE).all())


def _table(path: Any, lines: Sequence[Line], names: Sequence[str]) -> Table:
    columns = {name: [line.texts[j] for line in lines] for j, name in enumerate(names)}
    return Table(str(path), [line.number for line in lines], columns)


def _note(path: Any, names: Sequence[str], whose: str) -> str:
    said = " ".join("length" if name == EDGE else name for name in names)
    return f"{path} is read as {whose} {said}; a comment above the values can name others"


def _question(line: Line, reason: str) -> InputError:
    return InputError(
        f"line {line.number}, {' '.join(line.texts)[:200]!r}: {reason}. What are its values? Name them in a comment "
        f"above, such as '# {' '.join(BY_QUATERNION)}' or, for Clover's, '# id length x y z yaw pitch roll'."
    )


def _may_be_fiducial_slam(line: Line) -> bool:
    """True if a variance and whole numbers follow the pose: observations, and distinct tags seen with this tag."""
    counts, links = line.texts[8:9], line.texts[9:]
    whole = bool(counts) and all(text.isdecimal() for text in (*counts, *links))
    return whole and len(set(links)) == len(links) and is_number(line.texts[7]) and float(line.texts[7]) >= 0.0


def _fiducial_slam(line: Line) -> PlacedTag:
    """Tag of a line `id x y z roll pitch yaw variance observations`, degrees, then the tags that were seen with it."""
    pose = Line(line.number, line.texts[: len(BY_ANGLES)]).values(BY_ANGLES)
    return PlacedTag(line.id, pose[:3], roll_pitch_yaw(np.radians(pose[3:])))


def _clover(line: Line) -> PlacedTag:
    """Tag of a line `id length x y z yaw pitch roll`, in which the values after y may be missing."""
    if not CLOVER_LEAST <= len(line.texts) <= len(CLOVER):
        raise InputError(f"line {line.number}, {' '.join(line.texts)[:200]!r}, must be: {' '.join(CLOVER)}.")
    edge, *pose = line.values(CLOVER[: len(line.texts)]).tolist()
    x, y, z, yaw, pitch, roll = np.pad(pose, (0, len(CLOVER) - 2 - len(pose))).tolist()
    turn = turn_by_angles(line.id, roll, pitch, yaw)
    return PlacedTag(line.id, np.array([x, y, z]), turn, edge_of("length", edge))


def _by_angles(line: Line) -> PlacedTag:
    values = line.values(BY_ANGLES)
    return PlacedTag(line.id, values[:3], turn_by_angles(line.id, *values[3:].tolist()))


def read_priors(text: str) -> Found:
    """Tags of RTAB-Map's `Marker/Priors`, alone or in its configuration, separated by `|`.

    Raises:
        InputError: an entry is no tag.
    """
    found = PRIORS.search(text)
    value = text if found is None else found[1]
    edge = family = None
    if found is not None:
        if (length := _setting(text, "Length")) is not None and float(length) > 0.0:  # else RTAB-Map measures the edge
            edge = edge_of("Marker/Length", float(length))
        if (dictionary := _setting(text, "Dictionary")) is not None and dictionary.isdecimal():
            family = family_named(NUMBERS.get(int(dictionary), f"{dictionary} of OpenCV"))
    tags = []
    for entry in filter(None, (part.strip(" \t\r\n\"'") for part in value.split("|"))):
        texts = entry.split()
        if len(texts) != len(BY_ANGLES):
            raise InputError(f"{entry[:200]!r} must be: {' '.join(BY_ANGLES)}.")
        tags.append(_by_angles(Line(1, texts))._replace(edge=edge, family=family))
    return Found(tags, by_opencv=True)


def _setting(text: str, name: str) -> str | None:
    found = re.search(SETTING.format(name), text, re.MULTILINE)
    return None if found is None else found[1]


def _rtabmap_poses(lines: Sequence[Line], names: Sequence[str]) -> list[PlacedTag]:
    """Landmarks among the poses that RTAB-Map exports: poses with a negative id.

    Raises:
        InputError: there is no landmark.
    """
    tags = []
    for line in lines:
        values = dict(zip(names, [float(line.texts[0]), *line.values(names)], strict=True))
        if values[ID] < 0.0:
            place = np.array([values[name] for name in PLACE])
            turn = turn_by_quaternion(*(values[name] for name in QUATERNION))
            tags.append(PlacedTag(number_of(-values[ID]), place, turn))
    if not tags:
        raise InputError("it has poses of RTAB-Map, and no tag: a tag has a negative id.")
    return tags
