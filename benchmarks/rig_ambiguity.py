"""How often a body whose cameras see one tag is taken for another one: `python benchmarks/rig_ambiguity.py`.

Prints Markdown tables of `lmd.objectives.localisation.ambiguity` against fits to the corners in all images, which
begin at each image's two solutions of OpenCV's IPPE, and share no code with it:

1. by incidence: the closed form over the residual of the other pose, noise-free, and the share of wrong poses, as
   predicted and simulated with noise on the corners;
2. the share of views of one tag that localise, and of wrong poses among these.

The sum is that of the cameras' own residuals, without what they tell by seeing the tag from several places.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from statistics import NormalDist

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from lmd.core.checks import FloatArray
from lmd.objectives.localisation.ambiguity import CONFIDENCE, mirrored_numbers, rig_ratio

NOISE, EDGE, TOLERANCES = 0.5, 0.1, (0.05, 0.1)  # pixels, metres, metres
CASES, DRAWS, VIEWS, REPEATS = 60, 60, 1500, 3
INCIDENCES = (3.0, 10.0, 20.0, 40.0, 65.0)  # degrees
CORNERS = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])  # in half edges


@dataclass(frozen=True)
class Cameras:
    """C cameras that see a tag at the origin, which faces along z.

    Args:
        edge: of the tag, metres.
        centres: `(C, 3)`, metres.
        turns: world to camera, `(C, 3, 3)`.
        focal: pixels, `(C,)`.
    """

    edge: float
    centres: FloatArray
    turns: FloatArray
    focal: FloatArray

    @property
    def corners(self) -> FloatArray:
        """Corners of the tag, metres, `(4, 3)`."""
        return self.edge / 2.0 * CORNERS

    def images(self, motion: FloatArray) -> FloatArray:
        """The corners in all images, `(C, 4, 2)`, of a tag that is moved: rotation vector and shift, `(6,)`."""
        points = Rotation.from_rotvec(motion[:3]).apply(self.corners) + motion[3:]
        seen = np.einsum("cij,cpj->cpi", self.turns, points - self.centres[:, None])
        return np.asarray(self.focal[:, None, None] * seen[..., :2] / seen[..., 2:])

    def fits(self, images: FloatArray) -> list[tuple[float, FloatArray]]:
        """Squared residuals and motions `(6,)` of all fits."""
        found = []
        for turn, centre, focal, image in zip(self.turns, self.centres, self.focal, images, strict=True):
            matrix = np.diag([focal, focal, 1.0])
            solved = cv2.solvePnPGeneric(self.corners, image, matrix, None, flags=cv2.SOLVEPNP_IPPE)
            for rotation, shift in zip(*solved[1:3], strict=True):
                start = Rotation.from_matrix(turn.T @ cv2.Rodrigues(rotation)[0]).as_rotvec()
                motion = np.append(start, turn.T @ shift[:, 0] + centre)
                fit = least_squares(lambda x: (self.images(x) - images).ravel(), motion, method="lm", max_nfev=100)
                found.append((2.0 * fit.cost, fit.x))
        return found

    def other(self) -> float:
        """The root of the squared residual of the other pose, pixels; infinite if there is none."""
        fits = self.fits(self.images(np.zeros(6)))
        return float(np.sqrt(min((each for each, _ in fits if each > 1e-6), default=np.inf)))

    def wrong(self, noise: float, draws: int, rng: np.random.Generator) -> float:
        """Fraction of draws in which the best fit is nearer to the mirrored pose than to the true one."""
        exact, line = self.images(np.zeros(6)), self.centres.mean(axis=0)
        line = line / np.linalg.norm(line)
        away = 2.0 * (line[2] * line - np.eye(3)[2])  # from the true normal to the mirrored one
        count = 0
        for _ in range(draws):
            _, best = min(self.fits(exact + rng.normal(0.0, noise, exact.shape)), key=lambda fit: fit[0])
            normal = Rotation.from_rotvec(best[:3]).apply(np.eye(3)[2])
            count += bool(normal @ away > 0.0)
        return count / draws

    def deviation(self) -> float:
        """The standard deviation of the body's position, that of the cameras' mean, metres."""
        step = 1e-6
        sides = [(self.images(x) - self.images(-x)).ravel() / (2.0 * step) for x in step * np.eye(6)]
        covariance = np.linalg.inv(np.array(sides) @ np.array(sides).T) * NOISE**2
        moved = np.hstack([np.cross(np.eye(3), self.centres.mean(axis=0)).T, np.eye(3)])
        return float(np.sqrt(np.trace(moved @ covariance @ moved.T)))

    def told(self) -> tuple[float, float]:
        """sqrt(S) in pixels: the sum over the cameras, and by the closed form."""
        total = np.zeros(5)
        for turn, centre, focal in zip(self.turns, self.centres, self.focal, strict=True):
            half = self.edge / 2.0
            numbers = mirrored_numbers((-centre, (half, 0.0, 0.0), (0.0, half, 0.0)), 1.0)
            total += focal**2 * np.array(numbers) / (turn @ -centre)[2] ** 3
        return float(np.sqrt(total[0])), float(np.sqrt(rig_ratio(*total, 1.0)))


def cameras(edge: float, distance: float, incidence: float, spots: FloatArray, rng: np.random.Generator) -> Cameras:
    """Cameras at `spots` `(C, 3)` around a place, which see the tag at an incidence, degrees, off their axes."""
    around, steep = rng.uniform(-np.pi, np.pi), np.radians(incidence)
    away = np.array([np.sin(steep) * np.cos(around), np.sin(steep) * np.sin(around), np.cos(steep)])
    centres, turns = distance * away + spots, []
    for centre in centres:
        turn, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [-centre])
        turns.append((Rotation.from_rotvec(np.append(rng.uniform(-0.25, 0.25, 2), 0.0)) * turn).as_matrix())
    return Cameras(edge, centres, np.array(turns), rng.choice([400.0, 554.0, 800.0], len(spots)))


def anywhere(low: float, high: float, rng: np.random.Generator) -> Cameras:
    """Two or three cameras at random, whose incidence is between two, whose other pose is some pixels off."""
    while True:
        spots = rng.uniform(-0.5, 0.5, (rng.integers(2, 4), 3)) * rng.choice([0.1, 0.3, 0.6])
        edge, distance = rng.choice([0.05, 0.1, 0.15, 0.2]), rng.uniform(1.0, 5.0)
        found = cameras(edge, distance, rng.uniform(low, high), spots, rng)
        if 0.6 < found.told()[1] < 7.0:
            return found


def share_wrong(residual: float, noise: float) -> float:
    """P."""
    return NormalDist().cdf(-residual / (2.0 * noise))


def by_incidence(rng: np.random.Generator) -> Iterator[str]:
    """Rows of the first table."""
    for low, high in itertools.pairwise(INCIDENCES):
        ratios, shares, none = [], [], 0
        for _ in range(CASES):
            each = anywhere(low, high, rng)
            alone, told = each.told()
            other, noise = each.other(), told / rng.uniform(1.4, 4.4)
            none += not np.isfinite(other)
            if np.isfinite(other):
                ratios.append((alone / other, told / other))
            shares.append([share_wrong(alone, noise), share_wrong(told, noise), each.wrong(noise, DRAWS, rng)])
        spread = [" to ".join(f"{x:.2f}" for x in np.quantile(column, [0.05, 0.95])) for column in np.transpose(ratios)]
        wrong = " | ".join(f"{share:.3f}" for share in np.mean(shares, axis=0))
        yield f"| {low:g} to {high:g} | {none} of {CASES} | {' | '.join(spread)} | {wrong} |"


def localised(rng: np.random.Generator) -> Iterator[str]:
    """Rows of the second table: views from 1 to 5 m, 3 to 65 degrees."""
    for baseline in (0.0, 0.05, 0.2, 0.6):
        spots = np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]]) * baseline if baseline else np.zeros((1, 3))
        drawn = zip(*rng.uniform([[1.0], [3.0]], [[5.0], [65.0]], (2, VIEWS)), strict=True)
        every = [cameras(EDGE, d, i, spots, rng) for d, i in drawn]
        deviation = np.array([each.deviation() for each in every])
        told = np.array([[share_wrong(x, NOISE) <= 1.0 - CONFIDENCE for x in each.told()] for each in every])
        wrong = np.array([
            each.wrong(NOISE, REPEATS, rng) if near else 0.0
            for each, near in zip(every, deviation <= max(TOLERANCES), strict=True)
        ])  # fmt: skip
        for tolerance in TOLERANCES:
            near, row = deviation <= tolerance, f"| {100.0 * baseline:g} | {1e3 * tolerance:g} |"
            for which in (near, near & told[:, 0], near & told[:, 1]):
                row += f" {which.mean():.3f} | {wrong[which].mean():.4f} |"
            yield row


def table(title: str, head: str, rows: Iterator[str]) -> None:
    """Print a table row by row, as the rows are computed."""
    print(f"\n{title}\n\n| {head} |\n|{' --- |' * (head.count('|') + 1)}")
    for row in rows:
        print(row, flush=True)


def main() -> None:
    """Print the tables."""
    rng = np.random.default_rng(0)
    ratios, shares = "sum / residual | closed form / residual", "wrong: sum | closed form | simulated"
    head = f"incidence, degrees | no other pose | {ratios} | {shares}"
    table("By incidence", head, by_incidence(rng))
    head = "baseline, cm | tolerance, mm | ignored: views | wrong | sum: views | wrong | closed form: views | wrong"
    table(f"Views of a tag of {100 * EDGE:g} cm that localise", head, localised(rng))


if __name__ == "__main__":
    main()
