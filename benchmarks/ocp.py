"""Solve public instances of camera placement as set covers: `python benchmarks/ocp.py AC_01_cover.txt ...`.

The instances are those of the GECCO competitions of 2020 and 2021 (OCP/USCP): the fewest candidates, poses of cameras,
that cover all samples of a room. A file has numbers in ASCII, separated by blanks or line ends: the number of samples
and of candidates; then of each sample its index from 0, the number of candidates that cover it, and their indices
from 0.

Prints a table in Markdown: cameras that the greedy selection of `lmd.optimisers.selection` takes, that HiGHS finds and
proves at least; and, if both are equal, the samples that the program of `optimiser=milp` covers with as many cameras.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import coo_array, csr_array, eye_array

from lmd.core.checks import BoolArray, FloatArray, InputError
from lmd.optimisers.milp import Program
from lmd.optimisers.selection import select
from lmd.scene.deployment import Deployment

UP = np.array([0.0, 0.0, 1.0])  # any normal


@dataclass(frozen=True)
class Cover:
    """Instance of the set cover."""

    covers: csr_array
    """`(samples, candidates)` 1 where a candidate covers a sample."""

    @classmethod
    def read(cls, path: Path) -> "Cover":
        """Read an instance.

        Raises:
            InputError: the file is no instance.
        """
        try:
            numbers = np.array(path.read_text().split(), dtype=np.int64)
        except (OSError, ValueError, OverflowError) as error:
            raise InputError(f"{path}: no file of whole numbers ({error}).") from error
        if len(numbers) < 2 or (numbers[:2] < 1).any():
            raise InputError(f"{path}: it must begin with the numbers of samples and of candidates.")
        (samples, candidates), at = numbers[:2].tolist(), 2
        rows, columns = [], []
        for sample in range(samples):
            count = int(numbers[at + 1]) if at + 1 < len(numbers) else 0
            own = numbers[at + 2 : at + 2 + max(count, 0)]
            if not count or len(own) < count or numbers[at] != sample or ((own < 0) | (own >= candidates)).any():
                raise InputError(f"{path}: sample {sample} must have its index, and a count of candidates below "
                                 f"{candidates} followed by as many.")  # fmt: skip
            rows.append(np.full(count, sample))
            columns.append(own)
            at += 2 + count
        if at != len(numbers):
            raise InputError(f"{path}: {len(numbers) - at} numbers follow the {samples} samples that it announces.")
        places = np.concatenate(rows), np.concatenate(columns)
        return cls(csr_array((np.ones(len(places[0])), places), shape=(samples, candidates)))


class Uncovered:
    """Selection whose gain is the number of samples covered anew; candidate j is the pose with x = j."""

    label = "samples"

    def __init__(self, cover: Cover) -> None:
        self.covers, self.left = cover.covers.toarray() > 0.0, np.ones(cover.covers.shape[0], dtype=bool)

    def gains(self, poses: Deployment) -> FloatArray:
        """See `Selection.gains`."""
        return self.covers[self.left][:, poses.positions[:, 0].astype(int)].sum(axis=0).astype(float)

    def add(self, pose: Deployment) -> None:
        """See `Selection.add`."""
        self.left &= ~self.covers[:, int(pose.positions[0, 0])]


@dataclass(frozen=True)
class UntilCovered:
    """Stock of as many cameras as it takes."""

    selection: Uncovered

    def prices(self, poses: Deployment) -> FloatArray:
        """See `Stock.prices`."""
        return np.ones(len(poses))

    def none_left(self, poses: Deployment, chosen: Sequence[int]) -> BoolArray:
        """See `Stock.none_left`."""
        return np.full(len(poses), not self.selection.left.any())


def greedy(cover: Cover) -> int:
    """Number of cameras that the greedy selection takes."""
    count, selection = cover.covers.shape[1], Uncovered(cover)
    poses = Deployment(np.arange(count)[:, None] * [1.0, 0.0, 0.0], np.tile(UP, (count, 1)))
    return len(select(selection, poses, UntilCovered(selection))[0])


def fewest(cover: Cover, seconds: float) -> tuple[int, int]:
    """Number of cameras that HiGHS finds within the time, and the number that it proves to be needed."""
    count = cover.covers.shape[1]
    found = milp(
        np.ones(count),
        constraints=LinearConstraint(cover.covers, 1.0, np.inf),
        integrality=np.ones(count),
        bounds=Bounds(0.0, 1.0),
        options={"time_limit": seconds},
    )
    if found.x is None:
        raise InputError(f"HiGHS finds no cover within {seconds:g} s.")
    return int(np.rint(found.x).sum()), int(np.ceil(found.mip_dual_bound - 1e-6))


def covered(cover: Cover, cameras: int, seconds: float) -> tuple[int, bool]:
    """Number of samples that the program of a lattice covers with so many cameras, and True if that is proven."""
    samples, candidates = cover.covers.shape
    every = csr_array(eye_array(samples))
    program = Program(
        cover.covers,
        counted=np.zeros(samples, dtype=int),
        weights=every,
        overlaps=coo_array((0, candidates)),
        sizes=csr_array(np.ones((1, candidates))),
        counts=np.array([cameras]),
        relevance=np.ones(samples),
        n=1,
        threshold=1.0,
        copies=1,
    )
    solved = program.solver({"time_limit": seconds})()
    return (0 if solved.x is None else round(program.value(solved) * samples)), solved.status == 0


def main() -> None:
    """Solve and print."""
    parser = argparse.ArgumentParser(description="Solve instances of OCP/USCP; prints Markdown.")
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH", help="file such as AC_01_cover.txt")
    parser.add_argument("--seconds", type=float, default=120.0, help="time limit of each program")
    options = parser.parse_args()
    print("| instance | samples, candidates | greedy | HiGHS | at least | milp covers | processor seconds |")
    print("|" + 7 * " --- |")
    try:
        for path in options.paths:
            cover, began = Cover.read(path), time.process_time()
            samples, candidates = cover.covers.shape
            found, least = fewest(cover, options.seconds)
            told = "–"
            if found == least:
                most, proven = covered(cover, found, options.seconds)
                told = f"{most} with {found} ({'proven' if proven else 'not proven'})"
            print(f"| {path.stem} | {samples}, {candidates} | {greedy(cover)} | {found} | {least} | {told} "
                  f"| {time.process_time() - began:.0f} |", flush=True)  # fmt: skip
    except InputError as error:
        raise SystemExit(f"error: {error}") from error


if __name__ == "__main__":
    main()
