"""What a map from a fast video is worth when frames of it are left out, where the truth is known.

PYTHONPATH=tests python benchmarks/video.py [--seconds 120] [--seed 0]   # a row for each `survey.every` and correlation

A camera of 30 images a second is carried through a room of 24 tags. Each corner of each tag is off by 0.2 pixels, anew
in each image, or by an error that changes slowly: by half a second of correlation (exponential).
"""

import argparse
import time
from dataclasses import replace
from itertools import pairwise

import numpy as np
from support import walks  # of the tests

from lmd.core.checks import FloatArray
from lmd.formats.detections import DetectedTags
from lmd.geometry.se3 import act, camera_pose, rigid_alignment
from lmd.scene.tag import Tag
from lmd.survey.keyframes import select_keyframes
from lmd.survey.knowledge import PriorKnowledge
from lmd.survey.survey import survey

RATE, TAGS, SIGMA = 30, 24, 0.2
HEAD = (
    "| correlated, s | every | frames | off, median, mm | stated | off / stated, root mean square | processor time, s |"
)


def carried(times: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Poses of a camera that looks round once in half a minute, `(F, 4, 4)`."""

    def waves(size: float, fastest: float) -> FloatArray:
        hertz = np.linspace(fastest / 6.0, fastest, 6) * rng.uniform(0.9, 1.1, 6)
        return size * np.sqrt(1.0 / 3.0) * np.sin(2.0 * np.pi * (hertz * times[:, None] + rng.uniform(size=6))).sum(1)

    places = np.stack([2.5 + waves(0.5, 0.1), 2.0 + waves(0.4, 0.1), 1.4 + waves(0.1, 0.2)], axis=-1)
    return camera_pose(places, 2.0 * np.pi * times / 30.0 + waves(0.3, 0.3), waves(0.1, 0.3), waves(0.05, 0.3))


def filmed(tags: FloatArray, seconds: float, correlated: float, rng: np.random.Generator) -> DetectedTags:
    """What is detected, with corner errors that are alike for so many seconds."""
    times = np.arange(int(RATE * seconds)) / RATE
    exact = walks.photographed(tags, carried(times, rng), rng, 0.0)
    stays = np.exp(-1.0 / (RATE * correlated)) if correlated else 0.0
    errors = rng.normal(size=(len(times), len(tags), 4, 2))
    for before, here in pairwise(errors):
        here[:] = stays * before + np.sqrt(1.0 - stays**2) * here
    corners = exact.corners + SIGMA * errors[exact.frame, exact.ids]
    return replace(exact, corners=corners, times=tuple(f"{second:.4f}" for second in times))


def main() -> None:
    """See above."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    print(HEAD + "\n|" + " --- |" * 7)
    for correlated in (0.0, 0.5):
        rng = np.random.default_rng(given.seed)
        tags = walks.spaced_tags(TAGS, rng)
        detected = filmed(tags, given.seconds, correlated, rng)
        for every in (1, None):
            began, some = time.process_time(), select_keyframes(detected, every)
            found = survey(some, [walks.CAMERA], Tag(walks.EDGE), walks.constant_errors(SIGMA), PriorKnowledge())
            took, placed = time.process_time() - began, np.flatnonzero(found.placed)
            here, there = found.found.poses.tags[placed, :3, 3], tags[found.ids[placed], :3, 3]
            off = np.linalg.norm(act(rigid_alignment(here, there), here) - there, axis=1)
            stated = np.sqrt(np.trace(found.found.gauge_free_covariances[placed][:, 3:, 3:], axis1=1, axis2=2))
            ratio = float(np.sqrt(np.mean((off / stated) ** 2)))
            figures = f"{1e3 * np.median(off):.2f} | {1e3 * np.median(stated):.2f} | {ratio:.2f}"
            name, frames = every or "auto", len(np.unique(some.frame))
            print(f"| {correlated:g} | {name} | {frames} | {figures} | {took:.0f} |", flush=True)


if __name__ == "__main__":
    main()
