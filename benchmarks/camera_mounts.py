"""Where the cameras of a robot go on the FRC field: `python benchmarks/camera_mounts.py FOLDER ...`.

Each folder is one that this left, with 1, 2, 3 or 4 cameras:

    python -m pipelines.optimise varies=cameras experiment=frc_field_cameras \
        'room.path=${lmd.conf:experiment/2025-reefscape-welded.json}' budget.evaluations=600 validate=false

For each number of cameras a Markdown table compares the mounts that were found with the usual ones (at 0.5 m in the
middle of the front, the back, the left and the right face, level or raised by 15 degrees) and with the best of 500
random mounts, by the probability of seeing two tags: on the grid that was climbed and at held-out positions and
headings. Then AprilTag reads renderings from random poses of the robot, for the mounts of two cameras: every camera's
picture is rendered, and what any of them shows counts.

Options: `--random N` and `--poses N` in place of 500 and 400.
"""

import argparse
import math
from pathlib import Path

import numpy as np

from lmd.cameras.problem import CameraProblem
from lmd.core.checks import BoolArray, FloatArray
from lmd.detection.detectors import AprilTagDetector, shares_of_frames
from lmd.detection.frames import detect_in_frames, draw_poses, tagged_room
from lmd.evaluation.validation import Sample, sampled_values
from lmd.formats.rigs import read_mounts, rig_of
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import axis_and_right, pose_of
from lmd.optimisers.genetic import RandomSearch
from lmd.optimisers.ledger import Budget
from lmd.pipelines.composing import compose
from lmd.pipelines.optimise import build_camera_problem
from lmd.render.renderer import Renderer
from lmd.scene.rig import Mount, Rig
from lmd.sight.views import visible

FIELD = "room.path=${lmd.conf:experiment/2025-reefscape-welded.json}"
HELD_OUT = Sample(groups=8, positions=512, divisions=16)
SEED = 1  # of what was not climbed: random mounts, held-out poses, renderings
# The middles of the faces, in the order in which cameras come, and the turns.
USUAL = (((0.42, 0.0), 0.0), ((-0.42, 0.0), math.pi), ((0.0, 0.42), math.pi / 2), ((0.0, -0.42), -math.pi / 2))
RAISED = math.radians(15.0)
HEIGHT = 0.5  # metres
RENDERED = 2  # cameras
N = 2  # tags


def problem_of(count: int) -> CameraProblem:
    """The problem of the experiment."""
    cfg = compose("optimise", "varies=cameras", "experiment=frc_field_cameras", FIELD, f"cameras.count={count}")
    return build_camera_problem(cfg)[0]


def usual(camera: Camera, count: int, pitch: float) -> Rig:
    """The first `count` of the usual mounts."""
    return Rig(tuple(Mount(camera, (x, y, HEIGHT), yaw, pitch) for (x, y), yaw in USUAL[:count]))


def held_out(problem: CameraProblem, rig: Rig) -> tuple[float, float]:
    """The mean probability at held-out positions and headings, and its standard error."""
    means = sampled_values(problem.with_rig(rig), problem.tags, SEED, HELD_OUT).mean(axis=1)
    return float(means.mean()), float(means.std(ddof=1) / math.sqrt(len(means)))


def camera_poses(bodies: FloatArray, mount: Mount) -> FloatArray:
    """Optical frames `(N, 4, 4)` of a camera on bodies whose optical frames would be `bodies`, if they were cameras."""
    right, down, ahead = (bodies[:, :3, i] for i in range(3))
    body = np.stack([ahead, -right, -down], axis=-1)
    turned = body @ mount.rotation
    optical = np.stack([-turned[..., 1], -turned[..., 2], turned[..., 0]], axis=-1)
    return pose_of(optical, bodies[:, :3, 3] + body @ np.array(mount.translation))


def detected(problem: CameraProblem, rig: Rig, bodies: FloatArray) -> BoolArray:
    """Mask of the tags that AprilTag finds in the picture of any camera, `(N, K)`."""
    scene = problem.scene
    room, found = tagged_room(scene.room, problem.tags, scene.tag), []
    for i, mount in enumerate(rig.mounts):
        renderer, detectors = Renderer(mount.camera, room), {"apriltag": AprilTagDetector(scene.tag.family)}
        poses = camera_poses(bodies, mount)
        found.append(detect_in_frames(renderer, detectors, poses, i * len(bodies), SEED)["apriltag"].detected)
    return np.asarray(np.logical_or.reduce(found))


def row(*cells: str) -> None:
    """A line of a Markdown table."""
    print(f"| {' | '.join(cells)} |", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--random", type=int, default=500)
    parser.add_argument("--poses", type=int, default=320)
    given = parser.parse_args()
    row("cameras", "mounts", "on the grid", "held out")
    row(*["---"] * 4)
    for folder in given.folders:
        (camera,) = problem_of(1).space.lenses
        found = rig_of(read_mounts(folder / "rig.yaml"), camera)
        count = len(found.mounts)
        problem = problem_of(count)
        best = RandomSearch(seed=SEED).run(problem, Budget(given.random)).rig
        assert best is not None
        rigs = {
            "found": found,
            "usual, level": usual(camera, count, 0.0),
            "usual, raised 15 degrees": usual(camera, count, -RAISED),
            f"best of {given.random} random": best,
        }
        for name, rig in rigs.items():
            fitness, (share, error) = problem.fitness_of_cameras(rig.mounts), held_out(problem, rig)
            row(str(count), name, f"{fitness:.2%}", f"{share:.2%} +- {error:.2%}")
        if count == RENDERED:
            shown = problem, rigs
    if given.poses:
        problem, rigs = shown
        bodies = draw_poses(problem.scene, given.poses, SEED)
        print()
        row("mounts", "predicted: two tags or more", f"detected in renderings of {given.poses} poses")
        row(*["---"] * 3)
        for name, rig in rigs.items():
            evaluator = problem.with_rig(rig).evaluator
            told = visible(evaluator, problem.tags, bodies[:, :3, 3], axis_and_right(bodies))
            shares = [shares_of_frames(seen) for seen in (told, detected(problem, rig, bodies))]
            row(name, *(f"{s.share[N - 1]:.1%} +- {s.error[N - 1]:.1%}" for s in shares))


if __name__ == "__main__":
    main()
