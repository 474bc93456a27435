"""Acceptance of a map after its tags were hung: stations are chosen and measured, and wrongly hung tags are found.

A station is a pose of the camera or of the rig's body. At each of S stations a person measures the position with a tape
measure, and localisation estimates it from one image. A tag that hangs wrongly makes the two positions differ.

Let m `(6 K,)` be the errors in position and rotation of the K tags of the map. To first order the differences d
`(3 S,)` between the estimated and the tape-measured positions are

    d = A m + n.

In a map without wrong tags (a right map), d has the covariance C = A P A^T + N.

- A `(3 S, 6 K)` is the Jacobian of the estimated positions, see `lmd.estimation.pose_covariance`.
- P is the covariance of m in a right map: the errors that remain after hanging the tags or after a survey.
- N is the covariance of n, the effect of the errors of corners in the images, and of the errors of the tape measure.

If tag k hangs wrongly by s `(2,)`, right and up in its plane, B_k s is added to the mean of d. B_k `(3 S, 2)` has the
columns of A for these directions. With the information F_k = B_k^T C^-1 B_k, the estimated shift is s_k = F_k^-1 B_k^T
C^-1 d. The likelihood-ratio test of tag k has the statistic T_k = s_k^T F_k s_k. In a right map T_k has a chi-square
distribution with two degrees of freedom, otherwise a noncentral one with the noncentrality s^T F_k s.

The K tests of the tags share half of the rate of false alarms equally (Bonferroni). The S tests of the stations, d_s^T
C_ss^-1 d_s with three degrees of freedom, share the other half.

Stations are chosen greedily: each step adds the station that most raises the sum of the scores of all tags. The score
of a tag tells how well the chosen stations reveal that it hangs wrongly, by a given distance in the worst direction.
This error gives T_k a noncentrality. The score is this noncentrality divided by the noncentrality with which the test
is powerful enough, and at most 1.

The scores need F_k, and so A^T C^-1 A, for every candidate station. A_s and N_s are the parts of A and N for one
station s. Let G be the sum of A_s^T N_s^-1 A_s over the chosen stations, and R = (I + P G)^-1. Then A^T C^-1 A is G R,
and station c adds (A_c R)^T (N_c + A_c R P A_c^T)^-1 A_c R to this matrix.
"""

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Annotated, Any

import numpy as np
import pandas as pd
from scipy.linalg import block_diag
from scipy.special import chndtrinc
from scipy.stats import chi2

from lmd.adjust.gauge import diagonal_blocks, in_world, world_from_twists
from lmd.core.checks import BoolArray, Checked, Count, FloatArray, InputError, Positive, real
from lmd.core.tables import read_table
from lmd.core.words import few
from lmd.estimation.pose_covariance import TagErrors, pose_covariances
from lmd.evaluation.losses import TAGS_LISTED
from lmd.export.stations import write_stations
from lmd.formats.tag_map import TagMap
from lmd.geometry.se3 import axis_and_right, camera_pose
from lmd.geometry.squares import upright
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.sight.views import visible_to_each

LEAST_TAGS = 2  # a view of a single tag may have two poses
MOST_CANDIDATES = 2000  # stations from which some are chosen; of more, this many are drawn
LEAST_GAIN = 0.005  # the choice ends when a station adds less than this share of the noncentrality that one tag needs
LIKELIHOOD = 0.05  # tags with this share of the largest likelihood are named beside the tag that has it
BOUND = 0.95  # probability of the bounds
PLACE, REPORTED = ["x", "y", "z", "yaw_deg"], ["reported_x", "reported_y", "reported_z"]


@dataclass(frozen=True)
class Acceptance(Checked):
    """Settings of the acceptance of a map after its tags were hung.

    Raises:
        InputError: a value is out of range.
    """

    measured: str | None = None
    """CSV of measured stations, see `HungMap.judged`; None to choose stations."""
    tape: Positive = 0.005
    """Standard deviation of each taped coordinate of a station, metres."""
    shift: Positive = 0.02
    """Shift of a tag in its plane that the measurement must show, metres."""
    power: Annotated[float, partial(real, low=0.5, high=0.9999)] = 0.95
    """Least probability with which a tag that is off by `shift` is found."""
    alarm: Annotated[float, partial(real, low=1e-6, high=0.5)] = 0.01
    """Greatest probability of a false alarm: at least one test of a station or a tag fails although no tag hangs
    wrongly.
    """
    mean: Positive = 0.05
    """Greatest accepted mean of the position errors of all stations, metres. Only stations whose bound on the position
    error is at most this value are chosen.
    """
    largest: Positive = 0.10
    """Greatest accepted position error of a station, metres."""
    headings: Count = 12
    """Number of headings at each position of the room's grid."""
    pitch: Annotated[float, partial(real, low=-np.pi / 2.0, high=np.pi / 2.0)] = 0.0
    """Pitch of the optical axis at all stations, upward, rad."""
    zone: Positive = 2.0
    """Edge length of the square zones of the floor plan, metres; a zone fails if one of its stations fails."""


@dataclass(frozen=True)
class HungMap:
    """Map of K hung tags, and the errors that are expected if no tag hangs wrongly (in a right map)."""

    problem: Problem
    """Problem with the scene."""
    tags: Deployment
    """The K tags of the map."""
    errors: TagErrors
    """Errors of corners in images."""
    spread: FloatArray
    """Covariance P of the errors m in position and rotation of all tags in a right map, world frame, m^2 and rad^2,
    `(6 K, 6 K)`.
    """
    settings: Acceptance
    """Settings."""

    @cached_property
    def along(self) -> FloatArray:
        """Matrix `(6 K, 2 K)` that converts shifts of the K tags to the vector m `(6 K,)` of the errors in position and
        rotation of all tags, world frame. Each tag has two shifts, right and up in its plane.
        """
        return np.asarray(block_diag(*np.pad(np.stack(upright(self.tags.normals), axis=-1), [(0, 0), (0, 3), (0, 0)])))

    @cached_property
    def limit(self) -> float:
        """Greatest test statistic T at which a tag passes its test, that is, counts as hung right."""
        return float(chi2.isf(self.settings.alarm / 2.0 / len(self.tags), 2))

    def views(self, stations: FloatArray, read: BoolArray | bool = True) -> tuple[Any, ...]:
        """Predict the errors of localisation at stations.

        Args:
            stations: position (m) and heading (degrees) of each station, the columns `PLACE`, `(S, 4)`.
            read: mask of the tags that the camera reads if they are in view, `(S, K)`.

        Returns:
            shown: mask of the tags that are in view and read, `(S, K)`.
            slopes: Jacobian A_s of the estimated position at each station with respect to the errors of all tags in the
                map, `(S, 3, 6 K)`.
            noise: covariance N_s of the difference between the estimated and the tape-measured position for an exact
                map, `(S, 3, 3)`; infinite if the tags in view do not determine a pose.
            right: covariance of this difference for a map with its usual errors, in which no tag hangs wrongly, `(S, 3,
                3)`.
            bounds: upper bounds on the errors of position (m) and heading (degrees), `(2, S)`. If no tag hangs wrongly,
                an error is within its bound with the probability `BOUND`. The distribution of the squared position
                error is approximated by a scaled chi-square distribution of equal mean and variance.
        """
        scene, settings = self.problem.scene, self.settings
        poses = camera_pose(stations[:, :3], np.radians(stations[:, 3]), settings.pitch)
        seen = visible_to_each(self.problem.evaluator, self.tags, poses[:, :3, 3], axis_and_right(poses)) & read
        body, shown = (scene.cameras, scene.extrinsics), np.asarray(seen.any(axis=0))
        covariances, _, pulls = pose_covariances(*body, poses, self.tags, scene.tag, seen, self.errors)
        noise = in_world(poses, covariances) + np.diag(3 * [settings.tape**2] + 3 * [0.0])
        slopes = np.zeros((*shown.shape, 6, 6))
        slopes[shown] = world_from_twists(poses)[shown.nonzero()[0]] @ pulls
        slopes = np.swapaxes(slopes, 1, 2).reshape(len(poses), 6, -1)
        whole = noise + slopes @ self.spread @ np.swapaxes(slopes, 1, 2)
        right, yaw = whole[:, :3, :3], np.degrees(np.sqrt(chi2.ppf(BOUND, 1) * whole[:, 5, 5]))
        mean, square = np.trace(right, axis1=1, axis2=2), (right**2).sum(axis=(1, 2))
        with np.errstate(invalid="ignore"):  # no tags
            bounds = np.stack([np.sqrt(square / mean * chi2.ppf(BOUND, mean**2 / square)), yaw])
        return shown, slopes[:, :3], noise[:, :3, :3], right, bounds

    def report(self, seed: int) -> tuple[dict[str, Any], dict[str, float], str]:
        """Results of the acceptance: files (keyed by their names), metrics, and text for a terminal.

        If measured stations are given, the map is judged, see `judged`. Otherwise stations are chosen with the random
        `seed`, see `chosen`: the files are the tables of stations and tags, and a page to print; there are no metrics.
        """
        if self.settings.measured is not None:
            return self.judged(self.settings.measured)
        tags = TagMap(self.problem.scene.room, self.problem.scene.tag, self.tags)
        stations, shown = self.chosen(seed)
        missed = few(shown.id[~(shown.least_shift <= self.settings.shift)], TAGS_LISTED) or "none"
        text = f"{len(stations)} stations show a tag that is {self.settings.shift:g} m off; tags not shown: {missed}"
        page = partial(write_stations, tags=tags, stations=stations)
        return {"stations.csv": stations, "stations_tags.csv": shown, "stations.pdf": page}, {}, text

    def chosen(self, seed: int) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Choose stations to measure. Candidates are the positions of the room's grid, each with several headings; if
        there are more than `MOST_CANDIDATES`, this number is drawn with the random `seed`.

        Returns:
            stations: table with a row for each station. The columns are name, zone, position (m), heading (degrees),
                the position estimated by localisation (empty), ids of the tags in view, and bounds on the errors of
                position (m) and heading (degrees).
            tags: table with the number of stations that see each tag. Another column has the least shift, in the worst
                direction, that these stations reveal with the probability `Acceptance.power` (m; NaN for a tag that no
                station sees).

        Raises:
            InputError: no candidate has a bound on the position error of at most `Acceptance.mean`.
        """
        settings, grid = self.settings, self.problem.scene.room.grid()
        every = np.array([[*at, 360.0 / settings.headings * i] for at in grid for i in range(settings.headings)])
        every = np.random.default_rng(seed).permutation(every)[:MOST_CANDIDATES]
        shown, slopes, noise, _, bounds = self.views(every)
        bound = np.where(shown.sum(axis=1) >= LEAST_TAGS, bounds[0], np.inf)
        if bound.min() > settings.mean:
            raise InputError(f"mean = {settings.mean:g} m is below the least bound of {bound.min():.3g} m.", "mean")
        good = np.flatnonzero(bound <= settings.mean)
        which = good[self._fewest(slopes[good], noise[good])]
        at, seen = every[which], shown[which]
        zones = (settings.zone * np.floor(at[:, :2] / settings.zone)).tolist()
        names = {"station": np.arange(1, len(at) + 1), "zone": [f"x{x:g}y{y:g}" for x, y in zones]}
        stations = pd.DataFrame(names | dict(zip(PLACE, at.T, strict=True)) | dict.fromkeys(REPORTED, ""))
        stations["tags"] = [" ".join(map(str, self.tags.ids[own])) for own in seen]
        stations["bound"], stations["yaw_bound_deg"] = bounds[:, which]
        reached = self._reached(self._tested(slopes[which], noise[which])[0])
        least = settings.shift / np.sqrt(np.where(reached > 0.0, reached, np.nan))
        return stations, pd.DataFrame({"id": self.tags.ids, "stations": seen.sum(axis=0), "least_shift": least})

    def _reached(self, information: FloatArray) -> FloatArray:
        """Score of each tag: the noncentrality of its test divided by the noncentrality that the test needs, `(...)`.

        The tag is shifted by `Acceptance.shift` in the worst direction. The test must find this shift with the
        probability `Acceptance.power`. `information` has the Fisher information F about the shift of each tag, `(...,
        2, 2)`.
        """
        needed = chndtrinc(self.limit, 2, 1.0 - self.settings.power)
        return np.asarray(self.settings.shift**2 / needed * np.linalg.eigvalsh(information)[..., 0])

    def _tested(self, slopes: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Fisher information F about each tag's shift, `(K, 2, 2)`; and the matrix B^T C^-1 of all tags, `(2 K, 3 S)`.

        The module's docstring defines F, B and C. `slopes` and `noise` are the matrices A_s `(S, 3, 6 K)` and N_s `(S,
        3, 3)` of the stations, see `views`.
        """
        ours = np.concatenate(slopes)
        weighted = np.linalg.solve(ours @ self.spread @ ours.T + block_diag(*noise), ours @ self.along).T
        return diagonal_blocks(weighted @ ours @ self.along, 2), weighted

    def _fewest(self, slopes: FloatArray, noise: FloatArray) -> list[int]:
        """Choose stations greedily: each step adds the candidate that most raises the sum of all tags' scores.

        The function `_reached` gives the scores. A score of 1 is the goal: the tag's test then has the required power.
        In the sum, a score above 1 counts as 1. The choice ends when no candidate raises the sum by `LEAST_GAIN` or
        more.

        `slopes` and `noise` are the candidates' matrices A_s `(S, 3, 6 K)` and N_s `(S, 3, 3)`, see `views`. Returns
        the indices of the chosen candidates.
        """
        chosen, reached, total = list[int](), 0.0, np.zeros_like(self.spread)
        while True:
            left = np.linalg.inv(np.eye(len(total)) + self.spread @ total)
            root = np.linalg.cholesky(noise + slopes @ (left @ self.spread) @ np.swapaxes(slopes, 1, 2))
            added = np.linalg.solve(root, slopes @ (left @ self.along)).reshape(len(slopes), 3, -1, 2)
            information = diagonal_blocks(self.along.T @ total @ left @ self.along, 2)
            score = self._reached(information + np.einsum("cikx,ciky->ckxy", added, added)).clip(max=1.0).sum(axis=1)
            best = int(score.argmax())
            if score[best] < reached + LEAST_GAIN:
                return chosen
            chosen, reached = [*chosen, best], score[best]
            total += slopes[best].T @ np.linalg.solve(noise[best], slopes[best])

    def judged(self, path: str) -> tuple[dict[str, Any], dict[str, float], str]:
        """Decide from measured stations whether the map is accepted.

        Args:
            path: CSV of the stations. The columns `station,zone,x,y,z,yaw_deg` have the poses measured with a tape
                measure (m, degrees). Localisation gives the columns `reported_x,reported_y,reported_z` (m), and `tags`,
                the ids of the tags that were read. Other columns are ignored.

        Returns:
            files: three tables and the metrics, keyed by the name of their file. `acceptance.csv` has a row for each
                station: name, zone, position error and its bound (m), `chi_square` and its `limit`, `passed`.
                `acceptance_zones.csv` has a row for each zone: name, number of stations, mean and largest error (m),
                `passed`. `acceptance_tags.csv` has a row for each tag: the estimated shift to the `right` and `up` in
                the tag's plane (m), and the statistic T of its test (`ratio`). The column `named` is True for tags
                whose shift may explain the differences.
            figures: metrics, with `passed` as 0 or 1.
            text: text for a terminal.

        Raises:
            InputError: the file is not such a table, or a station is outside the room or shows too few tags.
        """
        settings, table = self.settings, read_table(path, name="measured")
        numbers = table.numbers([*PLACE, *REPORTED], None)
        if lacking := [column for column in ("station", "zone", "tags") if column not in table]:
            raise InputError(f"{path} lacks the column {lacking[0]!r}, which stations.csv has.")
        names, at, off = table.texts["station"], numbers[:, :4], numbers[:, 4:] - numbers[:, :3]
        read = np.array([np.isin(self.tags.ids.astype(str), text.split()) for text in table.texts["tags"]])
        shown, slopes, noise, right, bounds = self.views(at, read)
        error, outside = np.linalg.norm(off, axis=1), ~self.problem.scene.room.contains(at[:, :3])
        for i in np.flatnonzero(outside | (shown.sum(axis=1) < LEAST_TAGS)).tolist():
            fault = "is outside the room; give metres" if outside[i] else f"sees fewer than {LEAST_TAGS} listed tags"
            raise InputError(f"{path} line {table.lines[i]}: station {names[i]!r} at {at[i].tolist()} {fault}.")
        stations = pd.DataFrame({"station": names, "zone": table.texts["zone"], "error": error, "bound": bounds[0]})
        stations["chi_square"] = (off * np.linalg.solve(right, off[..., None])[..., 0]).sum(axis=1)
        stations["limit"] = chi2.isf(settings.alarm / 2.0 / len(off), 3)
        stations["passed"] = passed = (stations.chi_square <= stations.limit) & (error <= settings.largest)
        by_zone = stations.groupby("zone", sort=False)
        zones = by_zone.error.agg(["size", "mean", "max"]).assign(passed=by_zone.passed.all())
        information, weighted = self._tested(slopes, noise)
        pulled = (weighted @ off.ravel()).reshape(-1, 2)
        shift = (np.linalg.pinv(information, hermitian=True) @ pulled[..., None])[..., 0]
        ratio = (shift * pulled).sum(axis=1)
        named = (ratio.max() > self.limit) & (ratio > ratio.max() + 2.0 * np.log(LIKELIHOOD))
        tags = pd.DataFrame(
            {"id": self.tags.ids, "right": shift[:, 0], "up": shift[:, 1], "ratio": ratio, "named": named}
        )
        good = passed.all() and error.mean() <= settings.mean and not named.any()
        wrong = {"stations_failed": ~passed, "zones_failed": ~zones.passed, "tags_named": named}
        figures = {"passed": good, "mean_error": error.mean(), "largest_error": error.max(), "ratio_limit": self.limit}
        figures = {name: float(np.sum(value)) for name, value in (figures | wrong).items()}
        text = [f"{'passed' if good else 'failed'}; false alarms of the tests: {settings.alarm:g}"]
        text += [f"zone {zone} fails" for zone in zones.index[~zones.passed]]
        for tag in tags[named].sort_values("ratio", ascending=False).to_dict("records"):
            text.append("tag {id} explains this if it hangs {right:+.3f} m too far right, {up:+.3f} m up".format(**tag))
        files = {"acceptance.csv": stations, "acceptance_zones.csv": zones, "acceptance_tags.csv": tags}
        return {**files, "acceptance.json": figures}, figures, "\n".join(text)
