"""Prior knowledge of a survey: a plan, fixed tags, measured centres, printed boards, odometry."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lmd.adjust.prior import EXACT_SIGMA, FEWEST, Hanging, Prior, Sheets
from lmd.core.checks import Checked, FloatArray, InputError, IntArray, Positive, integer, real
from lmd.core.tables import read_table
from lmd.geometry.se3 import pose_of
from lmd.geometry.trajectory import Trajectory
from lmd.scene.deployment import Deployment, poses_of
from lmd.scene.labels import Labels
from lmd.scene.tag import Tag

TAPE_SIGMA_M = 0.005  # standard deviation of a centre measured with a tape measure, metres
# Minimum number of points that determine a world, and their minimum extent across the line that fits them best, metres.
FEWEST_POINTS, NO_LINE = 3, 0.05
# Standard deviations of tags on a bent sheet: shift out of the plane, metres; tilt out of the plane, rad; rotation in
# the plane, rad.
BENT, TILTED, TURNED = 0.001, 0.005, 0.001


def are_in_line(places: FloatArray) -> bool:
    """Return True if points `(n, 3)` are collinear."""
    return bool(np.linalg.svd(places - places.mean(axis=0), compute_uv=False)[1] < NO_LINE)


@dataclass(frozen=True)
class MeasuredPoints:
    """Centres of some tags, measured with a tape measure.

    Raises:
        InputError: there are fewer than three points, an id occurs twice, or all points lie in a line.
    """

    ids: IntArray
    """`(n,)` ids of the tags."""
    places: FloatArray
    """`(n, 3)` centres of the tags, metres."""

    def __post_init__(self) -> None:
        if len(self.ids) < FEWEST_POINTS:
            raise InputError(f"points must have at least {FEWEST_POINTS} tags, got {len(self.ids)}.", "points")
        if len(np.unique(self.ids)) < len(self.ids):
            raise InputError("points has a tag twice.", "points")
        if are_in_line(self.places):
            raise InputError("points must not be collinear.", "points")

    @classmethod
    def from_csv(cls, path: Any) -> "MeasuredPoints":
        """Read a CSV with the columns `id,x,y,z`; further columns are ignored.

        Raises:
            InputError: the file cannot be read, or the values violate a condition of `MeasuredPoints`.
        """
        table = read_table(path, name="points")
        rows = table.numbers(("id", "x", "y", "z"), None)
        return cls(Labels.of(table, ()).ids, rows[:, 1:])


@dataclass(frozen=True)
class Boards(Checked):
    """Flat printed sheets with several tags each. All tags on a sheet have their upper edges in one direction.

    Raises:
        InputError: a tag occurs twice, a sheet has only one tag, or the standard deviation `printed` is not positive.
    """

    names: tuple[str, ...]
    """Name of the sheet of each of M tags."""
    ids: IntArray
    """`(M,)` ids of the tags."""
    places: FloatArray
    """`(M, 2)` coordinates of the tags' centres on the sheet, x to the right and y up, metres."""
    printed: Positive
    """Standard deviation of `places`, metres."""

    def _validate(self) -> None:
        numbers, counts = np.unique(self.ids, return_counts=True)
        if (counts > 1).any():
            raise InputError(f"boards has tag {numbers[counts > 1][0]} twice.", "boards")
        sheets, counts = np.unique(self.names, return_counts=True)
        if (counts < FEWEST).any():
            raise InputError(f"boards: {str(sheets[counts < FEWEST][0])!r} has only one tag.", "boards")

    @classmethod
    def from_csv(cls, path: Any, printed: float) -> "Boards":
        """Read a CSV with the columns `board,id,x,y`; further columns are ignored.

        Raises:
            InputError: the file cannot be read, or the values violate a condition of `Boards`.
        """
        table = read_table(path, name="boards")
        if "board" not in table:
            raise InputError(f"{path} lacks the column board.", "boards")
        rows = table.numbers(("id", "x", "y"), None)
        return cls(tuple(table.texts["board"]), Labels.of(table, ()).ids, rows[:, 1:], printed)

    def among(self, ids: IntArray) -> Sheets:
        """Sheets with only those tags whose ids are among `ids` `(K,)`, which are ascending."""
        _, of, own = np.intersect1d(ids, self.ids, return_indices=True)
        places = np.hstack([self.places[own], np.zeros((len(own), 1))])
        board = np.unique(self.names, return_inverse=True)[1][own]
        deviations = np.array([TILTED, TILTED, TURNED, self.printed, self.printed, BENT])
        return Sheets(of, board, pose_of(np.eye(3), places), deviations**-2.0)


@dataclass(frozen=True)
class PriorKnowledge:
    """Knowledge that the user has before the survey. An optional attribute is None if the user lacks this knowledge.

    Raises:
        InputError: an edge length in `sizes` is not a number above 0.
    """

    plan: Deployment | None = None
    """Planned tags."""
    hanging: Hanging = field(default_factory=Hanging)
    """Standard deviations of the tags' true poses from their planned poses."""
    fixed: Deployment | None = None
    """Tags with exactly known poses."""
    points: MeasuredPoints | None = None
    """Tags with measured centres."""
    boards: Boards | None = None
    """Sheets on which several tags were printed together."""
    origin: int | None = None
    """Id of the tag whose frame is the world if nothing else defines one; None for the tag seen most often."""
    odometry: Trajectory | None = None
    """Trajectory of the body in any frame."""
    sizes: Mapping[int, float] = field(default_factory=dict)
    """Edge lengths of some tags, metres, keyed by id; they take precedence over those of the plan."""
    steady: bool | None = None
    """True to assume a nearly constant velocity between frames that are near in time, False not to. None to assume it
    if most frames show a single tag, or if images leave groups of tags unconnected.
    """

    def __post_init__(self) -> None:
        if not isinstance(self.sizes, Mapping):
            raise InputError(f"edges must give metres by id, as {{7: 0.125}}, got {self.sizes!r}.", "edges")
        for number, edge in self.sizes.items():
            integer("edges", number, low=0)
            real(f"edges of tag {number}", edge, above=0.0)

    @property
    def ids(self) -> IntArray:
        """Ids of all tags in the prior knowledge, ascending."""
        named = [known.ids for known in (self.plan, self.fixed, self.points) if known is not None]
        return np.unique(np.concatenate([np.empty(0, dtype=np.int64), *named]))

    def edges(self, ids: IntArray, tag: Tag) -> FloatArray:
        """Edge lengths of the tags `ids` `(K,)`, metres, `(K,)`. The lengths are taken from `sizes`, else from the
        fixed tags, else from the plan, else from `tag`.
        """
        edges = np.full(len(ids), tag.size)
        stated = [(known.ids, known.edges) for known in (self.plan, self.fixed) if known is not None]
        for known, own in (*stated, (np.array(list(self.sizes), dtype=int), np.array(list(self.sizes.values())))):
            given = _among(ids, known, own)
            edges = np.where(np.isnan(given), edges, given)
        return edges

    def planned(self, ids: IntArray) -> FloatArray:
        """Planned poses of the tags `ids` `(K,)`, `(K, 4, 4)`; NaN for tags that are not in the plan."""
        nothing = np.full((len(ids), 4, 4), np.nan)
        return nothing if self.plan is None else _among(ids, self.plan.ids, poses_of(self.plan))

    def prior(self, ids: IntArray) -> Prior:
        """Prior on the poses of the tags `ids` `(K,)`, ascending. The expected pose of a tag is its planned pose; a
        measured centre replaces the planned position. For fixed tags, the expected pose is the fixed pose. Tags without
        such knowledge have no prior. Tags on printed boards also have a prior relative to each other.
        """
        tags, information = np.tile(np.eye(4), (len(ids), 1, 1)), np.zeros((len(ids), 6))
        planned = np.isfinite(self.planned(ids)[:, 0, 0])
        tags[planned], information[planned] = self.planned(ids)[planned], self.hanging.deviations**-2.0
        if self.points is not None:
            places = _among(ids, self.points.ids, self.points.places)
            of = np.isfinite(places[:, 0])
            tags[of, :3, 3], information[of, 3:] = places[of], TAPE_SIGMA_M**-2.0
        if self.fixed is not None:
            poses = _among(ids, self.fixed.ids, poses_of(self.fixed))
            of = np.isfinite(poses[:, 0, 0])
            tags[of], information[of] = poses[of], EXACT_SIGMA**-2.0
        sheets = None if self.boards is None else self.boards.among(ids)
        return Prior(tags, information, sheets)


def _among(ids: IntArray, known: IntArray, values: FloatArray) -> FloatArray:
    """Rows of `values` `(n, ...)` for the tags `ids` `(K,)`, as an array `(K, ...)`; NaN for tags without a row.
    `known` `(n,)` has the id of the tag to which each row belongs.
    """
    found = np.full((len(ids), *values.shape[1:]), np.nan)
    _, of, own = np.intersect1d(ids, known, return_indices=True)
    found[of] = values[own]
    return found
