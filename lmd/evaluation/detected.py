"""Tests of deployments with real detectors: tags are detected in images rendered from random poses, and compared with
the model's predictions.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.memory import check_memory
from lmd.detection.detectors import Matches
from lmd.detection.frames import detect_in_frames, draw_crowd, draw_poses, tagged_room
from lmd.detection.predictions import CameraPrediction, Prediction, by_pitch, by_tag, figures
from lmd.evaluation.verdicts import verdicts
from lmd.geometry.se3 import axis_and_right
from lmd.problem import Problem
from lmd.render.renderer import Renderer
from lmd.sight.evaluator import Evaluator
from lmd.sight.views import visible_to_each

if TYPE_CHECKING:
    import pandas as pd

    from lmd.detection.detectors import Detector
    from lmd.render.imaging import Imaging
    from lmd.scene.tag import Tag

FRAME_BYTES = 100  # least memory of the prediction of a landmark in a frame, bytes
CHUNK = 10  # number of frames that are rendered and read at once
NAMES = ("deployment", "detector")  # first columns of the tables
Each = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]


@dataclass(frozen=True)
class Rendered:
    """Deployment to be tested: its predicted sightings from random poses, and the detectors for the rendered images."""

    problem: Problem
    """Problem of the deployment."""
    prediction: Prediction
    """Sightings that the visibility model predicts in each pose."""
    detectors: "Mapping[str, Detector]"
    """Detectors, keyed by name."""

    @classmethod
    def of(
        cls,
        problem: Problem,
        tag: "Tag",
        imaging: "Imaging",
        detectors: "Mapping[str, Detector]",
        frames: int,
        seed: int,
    ) -> "Rendered":
        """Predict the sightings of a problem's deployment from random poses.

        Args:
            problem: the problem; its landmarks may be points.
            tag: tag that is rendered at every landmark.
            imaging: optics and sensor with which images are rendered.
            detectors: detectors, keyed by name.
            frames: number of poses.
            seed: seed of the poses, and of a random deployment.

        Raises:
            InputError: a detector does not read the tags, the deployment cannot be rendered, or memory is too small.
        """
        for detector in detectors.values():
            detector.detect(np.zeros((64, 64), dtype=np.uint8))  # a missing package raises an error here
        deployment, scene = problem.draw(np.random.default_rng(seed)), problem.scene
        room = tagged_room(scene.room, deployment, tag)
        taken = f"frames = {frames} frames of {len(deployment)} landmarks"
        check_memory(FRAME_BYTES * frames * len(deployment), taken, "frames")
        poses = draw_poses(scene, frames, seed)
        scene, people = draw_crowd(scene, poses[:, :3, 3], seed)
        states = None if people is None else np.arange(frames)
        at = problem.evaluator
        if people is not None:
            at = Evaluator(scene, poses[:1, :3, 3], 1, states=np.zeros(1, dtype=int))
        seen = visible_to_each(at, deployment, poses[:, :3, 3], axis_and_right(poses), states)
        parts = []
        for camera, mounted, predicted in zip(scene.cameras, scene.extrinsics, seen, strict=True):
            own = poses @ mounted
            told = verdicts(scene, deployment, own, camera, states)
            parts.append(CameraPrediction(Renderer(camera, room, imaging), own, predicted, told, people=people))
        return cls(problem, Prediction(tuple(parts), scene.extrinsics, poses), detectors)


class Frames(NamedTuple):
    """Consecutive frames of one camera, which one process renders and in which it detects tags.

    `first` is the number of the first frame; the noise of a frame depends on the frame's number.
    """

    renderer: Renderer
    detectors: "Mapping[str, Detector]"
    poses: FloatArray
    first: int
    seed: int
    people: Sequence[FloatArray] | None


def look(job: Frames) -> dict[str, Matches]:
    """Render frames and detect the tags; return the detections, keyed by the name of the detector."""
    return detect_in_frames(job.renderer, job.detectors, job.poses, job.first, job.seed, job.people)


def sightings(subjects: Mapping[str, Rendered], seed: int, each: Each) -> dict[str, dict[str, Matches]]:
    """Detect the tags in the rendered images of all subjects (deployments with their predictions); return the
    detections, keyed by the name of the subject and then by the name of the detector.

    Args:
        subjects: subjects, keyed by name.
        seed: seed of the image noise.
        each: function such as `map`, which applies a function to each job, in the order of the jobs.
    """
    jobs = {}
    for name, subject in subjects.items():
        for c, part in enumerate(subject.prediction.parts):
            for first in range(0, len(part.poses), CHUNK):
                some = slice(first, first + CHUNK)
                people = None if part.people is None else part.people[some]
                job = part.renderer, subject.detectors, part.poses[some], c * len(part.poses) + first, seed, people
                jobs[name, c, first] = Frames(*job)
    found = dict(zip(jobs, each(look, list(jobs.values())), strict=True))

    def of(name: str, camera: int, detector: str) -> Matches:
        return Matches.concatenated([part[detector] for key, part in found.items() if key[:2] == (name, camera)])

    def beside(name: str, detector: str) -> Matches:
        return Matches.beside([of(name, c, detector) for c in range(len(subjects[name].prediction.parts))])

    return {name: {key: beside(name, key) for key in subject.detectors} for name, subject in subjects.items()}


@dataclass(frozen=True)
class DetectionStudy:
    """Detections of several deployments, compared with their predictions."""

    subjects: Mapping[str, Rendered]
    """Deployments with their predictions, keyed by name."""
    seen: Mapping[str, Mapping[str, Matches]]
    """Detections, keyed by the name of the subject and then by the name of the detector."""

    @cached_property
    def tables(self) -> "dict[str, pd.DataFrame]":
        """Three tables, keyed by name: `figures` with the metrics, `pitches` with the tags in bins of pitch, and `tags`
        with single tags. In each, the columns `NAMES` (deployment and detector) come first.
        """
        import pandas as pd

        rows, pitches, tags = [], [], []
        for name, subject in self.subjects.items():
            for detector, found in self.seen[name].items():
                names, told = dict(zip(NAMES, (name, detector), strict=True)), subject.prediction
                rows.append({**names, **figures(told, found)})
                pitches.append(by_pitch(told, found).assign(**names))
                tags.append(by_tag(told, found).assign(**names))
        ordered = [pd.concat(tables, ignore_index=True) for tables in (pitches, tags)]
        by_class, by_id = (table[[*NAMES, *table.columns.drop(list(NAMES))]] for table in ordered)
        return {"figures": pd.DataFrame(rows), "pitches": by_class, "tags": by_id}

    def metrics(self) -> dict[str, float]:
        """Finite values of the metrics, keyed by `<metric>/<deployment>/<detector>`."""
        records = self.tables["figures"].to_dict("records")
        found = {
            f"{key}/{row['deployment']}/{row['detector']}": row[key]
            for row in records
            for key in row
            if key not in NAMES
        }
        return {name: float(value) for name, value in found.items() if math.isfinite(value)}
