"""Let real detectors read rendered images: `python -m pipelines.detect deployment=uniform,random [overrides]`.

All deployments are rendered from equal random poses in one run, so `deployment=a,b,c` is no sweep: it is read as
`deployments=[a,b,c]`.
"""

import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from omegaconf import DictConfig

from .app import run_directory
from .building import build_problem
from .deployments import any_deployment, composed_deployments, read_deployment_as_a_list
from .nodes import detector_of, instantiate, keyed
from .outputs import write_document
from .pipeline import Pipeline

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd

    from lmd.core.checks import FloatArray
    from lmd.detection.detectors import Detector
    from lmd.detection.evaluation import Matches
    from lmd.detection.predictions import Prediction
    from lmd.problem import Problem
    from lmd.render.renderer import Renderer

FRAME_BYTES = 100  # least memory of the prediction of a landmark in a frame, bytes
CHUNK = 10  # number of frames that a worker renders and reads at once


def read_number_of_poses() -> None:
    """Read `poses=500` on the command line as `frames=500`; `poses=recorded` is an option of the group `poses`."""
    sys.argv[1:] = [re.sub(r"^poses=(?=[-+.\d])", "frames=", argument) for argument in sys.argv[1:]]


@dataclass(frozen=True)
class Subject:
    """Deployment, its prediction in random poses, and the detectors of its images."""

    problem: "Problem"
    """Problem of the deployment."""
    prediction: "Prediction"
    """Predicted sightings in each pose."""
    detectors: Mapping[str, "Detector"]
    """Detectors by name."""

    def nudged(self, sizes: object, seed: int) -> "Subject":
        """Subject with poses that are perturbed at random by `sizes`, standard deviations in metres and rad."""
        from lmd.core.checks import vector
        from lmd.detection.frames import nudged

        position, attitude = vector("nudge", sizes, 2, low=0.0)
        poses = nudged(self.prediction.poses, position, attitude, seed)
        return replace(self, prediction=self.prediction.moved(poses))


def detect(cfg: DictConfig) -> None:
    """Run the configured detectors on frames of the configured deployments."""
    from lmd.core.checks import integer, seed_number
    from lmd.core.optional import optional
    from lmd.detection.predictions import to_markdown
    from lmd.plot.detection_figures import save_calibration_figure

    from .tracked_run import keep, title_of, tracked

    optional("cv2", "detection")
    seed, count = seed_number(cfg.seed), integer("poses", cfg.frames, low=1)
    pictures = integer("pictures", cfg.pictures, low=0)
    composed = composed_deployments(cfg, "detect")
    subjects = {name: subject_of(own, count, seed) for name, own in composed.items()}
    moved = {} if cfg.nudge is None else {name: subject.nudged(cfg.nudge, seed) for name, subject in subjects.items()}
    problem, directory = next(iter(subjects.values())).problem, run_directory()
    with tracked(cfg, "detect", problem=problem) as tracker:
        seen = sightings(subjects, seed, cfg.workers)
        again = sightings(moved, seed + 1, cfg.workers) if moved else None
        figures, pitches, tags = _tables(subjects, seen, again)
        markdown = to_markdown(figures)
        (directory / "detect.md").write_text(markdown)
        for name, table in (("figures", figures), ("pitches", pitches), ("tags", tags)):
            table.to_csv(directory / f"{name}.csv", index=False)
        metrics = _metrics(figures)
        document = {"figures": metrics, "poses": count, "seed": seed, "settings": problem.settings()}
        write_document(directory / "detect.json", document)
        title = title_of(problem, f"{count} poses,")
        save_calibration_figure(directory / "calibration.png", figures, pitches, title)
        frames = _save_frames(directory / "frames", subjects, seen, min(pictures, count), seed)
        names = ("detect.md", "figures.csv", "pitches.csv", "tags.csv", "detect.json", "calibration.png")
        files = [*(directory / name for name in names), *frames]
        keep(tracker, files, metrics)
    print(f"{markdown}\nfiles: {directory}\nmlflow: {tracker.describe()}")


def subject_of(cfg: DictConfig, count: int, seed: int) -> Subject:
    """Deployment with its prediction in random poses, and detectors that were tested.

    Args:
        cfg: configuration with one deployment.
        count: number of poses.
        seed: seed of the poses, and of a random deployment.

    Raises:
        InputError: the deployment, the tag or a detector is refused.
    """
    import numpy as np

    from lmd.core.checks import InputError
    from lmd.core.memory import check_memory
    from lmd.detection.frames import draw_crowd, draw_poses, tagged_room
    from lmd.detection.predictions import CameraPrediction, Prediction
    from lmd.evaluation.verdicts import verdicts
    from lmd.geometry.se3 import axis_and_right
    from lmd.render.renderer import Renderer
    from lmd.sight.evaluator import Evaluator
    from lmd.sight.views import visible_to_each

    tag, imaging = instantiate(cfg.tag), instantiate(cfg.imaging)
    problem = build_problem(any_deployment(cfg))
    scene = problem.scene
    with keyed():
        tag.check_edge()
    detectors = {name: detector_of(cfg, name) for name in cfg.get("detectors") or {}}
    if not detectors:
        raise InputError("detectors must name at least one detector.")
    for detector in detectors.values():
        detector.detect(np.zeros((64, 64), dtype=np.uint8))  # a missing package raises an error here
    deployment = problem.draw(np.random.default_rng(seed))
    with keyed("tag"):
        room = tagged_room(scene.room, deployment, tag)
    taken = f"poses = {count} frames of {len(deployment)} landmarks"
    check_memory(FRAME_BYTES * count * len(deployment), taken, "poses")
    poses = draw_poses(scene, count, seed)
    with keyed("visibility.crowd"):
        scene, people = draw_crowd(scene, poses[:, :3, 3], seed)
    states = None if people is None else np.arange(count)
    at = problem.evaluator if people is None else Evaluator(scene, poses[:1, :3, 3], 1, states=np.zeros(1, dtype=int))
    seen = visible_to_each(at, deployment, poses[:, :3, 3], axis_and_right(poses), states)
    parts = []
    for camera, mounted, predicted in zip(scene.cameras, scene.extrinsics, seen, strict=True):
        own = poses @ mounted
        told = verdicts(scene, deployment, own, camera, states)
        parts.append(CameraPrediction(Renderer(camera, room, imaging), own, predicted, told, people=people))
    return Subject(problem, Prediction(tuple(parts), scene.extrinsics, poses), detectors)


class Frames(NamedTuple):
    """Frames of one camera of a subject, for a worker; the noise of a frame depends on its number."""

    name: str
    camera: int
    renderer: "Renderer"
    detectors: Mapping[str, "Detector"]
    poses: "FloatArray"
    first: int
    seed: int
    people: "Sequence[FloatArray] | None"


def sightings(subjects: Mapping[str, Subject], seed: int, workers: int | None) -> dict[str, dict[str, "Matches"]]:
    """Detections by the names of subject and detector; the result does not depend on the number of workers.

    Args:
        subjects: subjects by name.
        workers: number of processes; None for every processor.
    """
    from lmd.detection.evaluation import Matches

    from .progress import bar
    from .workers import in_processes

    jobs = [
        Frames(
            name,
            c,
            part.renderer,
            subject.detectors,
            part.poses[first : first + CHUNK],
            c * len(part.poses) + first,
            seed,
            None if part.people is None else part.people[first : first + CHUNK],
        )
        for name, subject in subjects.items()
        for c, part in enumerate(subject.prediction.parts)
        for first in range(0, len(part.poses), CHUNK)
    ]
    found = {}
    with bar(sum(len(job.poses) for job in jobs), "frames") as progress:
        for name, camera, first, part in in_processes(_look, jobs, workers, lambda job: f"frames of {job.name}"):
            found[name, camera, first] = part
            progress.update(len(next(iter(part.values())).false))

    def of(name: str, camera: int, detector: str) -> Matches:
        return Matches.concatenated([found[key][detector] for key in sorted(found) if key[:2] == (name, camera)])

    return {
        name: {
            key: Matches.beside([of(name, c, key) for c in range(len(subject.prediction.parts))])
            for key in subject.detectors
        }
        for name, subject in subjects.items()
    }


def _look(job: Frames) -> tuple[str, int, int, dict[str, "Matches"]]:
    """Render and read frames, on one thread."""
    from lmd.core.optional import optional
    from lmd.detection.frames import detect_in_frames

    optional("cv2", "detection").setNumThreads(1)
    found = detect_in_frames(job.renderer, job.detectors, job.poses, job.first, job.seed, job.people)
    return job.name, job.camera, job.first, found


def _tables(
    subjects: Mapping[str, Subject],
    seen: Mapping[str, Mapping[str, "Matches"]],
    again: Mapping[str, Mapping[str, "Matches"]] | None,
) -> "tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]":
    """Tables of figures, of classes of pitch, and of tags, each with the columns `deployment` and `detector`."""
    import pandas as pd

    from lmd.detection.predictions import by_pitch, by_tag, figures, repeatability

    rows, pitches, tags = [], [], []
    for name, subject in subjects.items():
        for detector, found in seen[name].items():
            names = {"deployment": name, "detector": detector}
            looks = {} if again is None else repeatability(found, again[name][detector], subject.prediction)
            rows.append({**names, **figures(subject.prediction, found), **looks})
            pitches.append(by_pitch(subject.prediction, found).assign(**names))
            tags.append(by_tag(subject.prediction, found).assign(**names))
    ordered = [pd.concat(tables, ignore_index=True) for tables in (pitches, tags)]
    first = ["deployment", "detector"]
    by_class, by_id = (table[[*first, *table.columns.drop(first)]] for table in ordered)
    return pd.DataFrame(rows), by_class, by_id


def _metrics(figures: "pd.DataFrame") -> dict[str, float]:
    """Finite figures by `<figure>/<deployment>/<detector>`."""
    import math

    return {
        f"{key}/{row['deployment']}/{row['detector']}": float(value)
        for row in figures.to_dict("records")
        for key, value in row.items()
        if key not in ("deployment", "detector") and math.isfinite(value)
    }


def _save_frames(
    folder: "Path",
    subjects: Mapping[str, Subject],
    seen: Mapping[str, Mapping[str, "Matches"]],
    count: int,
    seed: int,
) -> "list[Path]":
    """Draw the first frames of each deployment with the detections of its first detector, for every camera of a rig."""
    import numpy as np

    from lmd.detection.frames import rendered_frame
    from lmd.plot.detection_figures import save_frame

    files = []
    for name, subject in subjects.items():
        found, parts = next(iter(seen[name].values())), subject.prediction.parts
        for c, told in enumerate(parts):
            its = np.split(found.corners, len(parts), axis=1)[c]
            for i in range(count):
                folder.mkdir(exist_ok=True)
                files.append(folder / (f"{name}_{i}_{c}.png" if len(parts) > 1 else f"{name}_{i}.png"))
                among = told.renderer
                if told.people is not None:
                    among = replace(among, room=among.room.among(told.people[i]))
                image = rendered_frame(among, told.poses[i], c * len(told.poses) + i, seed)
                save_frame(files[-1], image, told.corners[i], told.visible[i], its[i])
    return files


# The number of poses is read first, as the next step takes `poses=` as an option of the group.
main = Pipeline("detect", detect, (read_number_of_poses, read_deployment_as_a_list))

if __name__ == "__main__":
    main()
