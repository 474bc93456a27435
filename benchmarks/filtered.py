"""Deployments for the filtered pose, for single images and for coverage: predicted along fresh drives, and flown.

PYTHONPATH=.:tests python benchmarks/filtered.py moves                     # cost of a tried move beside localisation's
PYTHONPATH=.:tests python benchmarks/filtered.py shares lab                # predicted, by tags and odometry
PYTHONPATH=.:tests python benchmarks/filtered.py flown lab --tags 6 --drives 40 --detector noisy
PYTHONPATH=.:tests python benchmarks/filtered.py flown corridor --tags 16 --drives 40 --detector noisy
PYTHONPATH=.:tests python benchmarks/filtered.py picture lab --tags 6 FILE.png
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from filtered_recording import corner_errors, lasting_noise, within
from support.composing import composed

from lmd.core.checks import FloatArray, IntArray
from lmd.core.compiled import kernel
from lmd.core.layers import layer, layers
from lmd.estimation.fusion import FixedLagSmoother, InvariantKalmanFilter
from lmd.estimation.recording import Flight, Odometry, record
from lmd.geometry.se3 import exp
from lmd.incremental.field import BOUND, NO_UNITS, SETTLE, perform
from lmd.objectives.filtered.sightings import begin, see
from lmd.objectives.reference_field import field_of
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from pipelines.building import build_problem
from pipelines.nodes import instantiate

CORRIDOR = (
    "room=floor_plan", "room.outline=[[0,0],[60,0],[60,2.4],[0,2.4]]", "room.holes=[]", "room.keep_out=[]",
    "room.surfaces=[wall_0,wall_1,wall_2,wall_3]", "room.spacing=1",
)  # fmt: skip
ROOMS = {"lab": (), "corridor": (*CORRIDOR, "pdf=yaw")}
START = 0.1, 0.05  # standard deviations of the first estimate, metres and rad
SHARED = (f"objective.start_position={START[0]}", f"objective.start_attitude={START[1]}")
OBJECTIVES = {
    "filtered": ("objective=filtered", *SHARED),
    "localisation": ("objective=localisation", "objective.n=1"),
    "coverage": ("objective=mean", "objective.n=1"),
}
NOISE = {"slow": (), "fast": ("objective.odometry.turn_noise=0.005", "objective.odometry.motion_noise=0.02")}
TOLERANCE = 0.02  # of the position, metres
OPTIMISED_ON = 96  # drives
SEEDS = 3  # of annealing, in `shares`
TRIES, ROUNDS = 200, 7  # random moves, and repetitions, in `moves`


def problem_of(room: str, objective: str, tags: int, odometry: str = "slow", *more: str) -> Problem:
    """Problem of a room and an objective; drives of the corridor are longer."""
    given = [*ROOMS[room], *OBJECTIVES[objective], f"deployment.count={tags}", "threads=1", *more]
    if objective == "filtered":
        given += [*NOISE[odometry], f"objective.drives={OPTIMISED_ON}"]
        given += [f"objective.trajectory.duration={40 if room == 'corridor' else 20}"]
    return build_problem(composed("optimise", "experiment=lab", *given))


def placed(problem: Problem, evaluations: int, seed: int = 0) -> Deployment:
    """Deployment that annealing finds."""
    return Annealing(seed=seed).run(problem, Budget(evaluations)).deployment


def moves() -> None:
    """Print the processor time of a tried move of the filtered objective and of localisation, by their defaults, and of
    localisation with a single orientation at each position, as a frame of a drive has; the mean share of the frames
    that a move makes the filter compute again; and the time that finding the changed frames takes, without the filter.
    """
    print("| objective | positions | views | tried move, us | per view, ns | filtered again |")
    print("| --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as folder:
        one = Path(folder) / "one.csv"
        one.write_text("yaw,pitch,weight\n0.3,0,1\n")
        single = ["pdf=samples", f"pdf.path={one}", "room.spacing=0.1"]
        rows = {"filtered": ["objective=filtered"], "localisation": [], "localisation, one orientation": single}
        problems = {
            name: build_problem(composed("optimise", "experiment=lab", *row, "threads=1")) for name, row in rows.items()
        }
    for name, problem in problems.items():
        evaluator = problem.fitness_evaluator
        positions = len(evaluator.positions)
        views = positions * (1 if name == "filtered" else len(evaluator.scene.orientations.axes))
        cost, again = _tried(problem)
        print(
            f"| {name} | {positions} | {views} | {1e6 * cost:.0f} | {1e9 * cost / views:.1f} | {again:.0%} |",
            flush=True,
        )
    print(
        f"Without the filter, a tried move of the filtered objective takes {1e6 * _seen(problems['filtered']):.0f} us."
    )


@kernel
def _see(steps: IntArray, poses: FloatArray, field: Any, state: Any, scratches: Any) -> None:
    """Find the frames that each of the moves `steps` changes, without filtering them."""
    scratch = layer(scratches, 0)
    for s in range(len(steps)):
        begin(field, steps[s, 1], poses[s], steps[s, 2], state, scratch)
        see(field, steps[s, 1], state, scratch)


def _seen(problem: Problem) -> float:
    """Least processor seconds, over rounds of random moves, in which the frames that a move changes are found."""
    field, state, scratches, steps, poses = _random_moves(problem)
    steps, poses = steps[::2], poses[::2]
    _see(steps[:1], poses[:1], field, state, scratches)
    return min(_seconds(lambda: _see(steps, poses, field, state, scratches)) for _ in range(ROUNDS)) / TRIES


def _seconds(action: Callable[[], None]) -> float:
    began = time.process_time()
    action()
    return time.process_time() - began


def _random_moves(problem: Problem) -> tuple[Any, Any, Any, IntArray, FloatArray]:
    """Field, state and scratches of a random deployment; steps and poses that try and settle `TRIES` random moves."""
    field, rng = field_of(problem.objective, problem.fitness_evaluator), np.random.default_rng(1)
    state = field.state(problem.draw(np.random.default_rng(0)))
    drawn = [problem.draw(rng) for _ in range(1 + TRIES // problem.count)]
    poses = np.concatenate([np.hstack([each.positions, each.normals]) for each in drawn])[:TRIES].repeat(2, axis=0)
    steps = np.zeros((TRIES, 2, 4), dtype=np.int64)
    steps[:, :, 0], steps[:, :, 1] = (BOUND, SETTLE), rng.integers(0, problem.count, TRIES)[:, None]
    steps[:, :, 2] = np.concatenate([each.surfaces for each in drawn])[:TRIES, None]
    return field, state, layers(field.scratch(state), 1), steps.reshape(-1, 4), poses


def _tried(problem: Problem) -> tuple[float, float]:
    """Least processor seconds of a tried move, over rounds of random moves; share of the frames filtered again."""
    field, state, scratches, steps, poses = _random_moves(problem)
    seconds = [_seconds(lambda: perform(steps, poses, field, state, scratches, NO_UNITS)) for _ in range(ROUNDS)]
    again = 0
    for k in range(0, len(steps), 2):
        perform(steps[k : k + 2], poses[k : k + 2], field, state, scratches, NO_UNITS)
        again += int((field.first[1:] - scratches.starts[0]).sum()) if hasattr(scratches, "starts") else 0
    return min(seconds) / TRIES, again / TRIES / len(state.units)


def shares(room: str, evaluations: int) -> None:
    """Print the filtered share on fresh drives by number of tags, odometry and objective, over `SEEDS` seeds."""
    names = " | ".join(OBJECTIVES)
    print(f"| tags | odometry | {names} |\n| --- | --- | {' | '.join(['---'] * len(OBJECTIVES))} |")
    for tags in (4, 8, 24):
        others = {name: _several(problem_of(room, name, tags), evaluations) for name in ("localisation", "coverage")}
        for odometry in ("slow", "fast"):
            problem = problem_of(room, "filtered", tags, odometry)
            along, evaluator = problem.objective.fresh, problem.evaluator
            texts = []
            for found in ({"filtered": _several(problem, evaluations), **others}).values():
                known = [problem.objective.poses(evaluator, one, along).known.astype(float) for one in found]
                by_drive = 100.0 * np.stack([along.share_of(own, along.seconds) for own in known])
                error = by_drive.mean(axis=0).std(ddof=1) / np.sqrt(len(along))
                each = by_drive.mean(axis=1)
                texts.append(f"{each.mean():.1f} +- {error:.1f} ({each.min():.1f} to {each.max():.1f})")
            print(f"| {tags} | {odometry} | {' | '.join(texts)} |", flush=True)


def _several(problem: Problem, evaluations: int) -> list[Deployment]:
    return [placed(problem, evaluations, seed) for seed in range(SEEDS)]


def predicted(covariances: FloatArray) -> float:
    """Mean probability of a position error of at most the tolerance, for covariances `(F, 21)`."""
    blocks = covariances[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    return float(within(blocks, TOLERANCE).mean())


def flown(room: str, tags: int, evaluations: int, drives: int, detector: str, odometry: str) -> None:
    """Print predicted shares along fresh drives, and those of estimators that fly them."""
    problem = problem_of(room, "filtered", tags, odometry, f"objective.fresh={drives}")
    along = problem.objective.fresh
    cfg = composed("evaluate", "studies=[observe]", f"sensor={detector}", f"tag.edge={problem.scene.tag.size}")
    sensor = instantiate(cfg.sensor, **({"missed": 0.0} if detector == "noisy" else {}))
    noise = Odometry(along.turn_noise, along.motion_noise)
    least = {"least_turn_noise": 1e-4, "least_motion_noise": 1e-4}
    estimators = {
        "IEKF, corners": InvariantKalmanFilter(START[1], START[0], measured="corners", **least),
        "IEKF, points": InvariantKalmanFilter(START[1], START[0], **least),
        "smoother": FixedLagSmoother(START[1], START[0], **least),
    }
    head = ["deployment", "known where optimised on, % of time", "known, % of time", "predicted within, %"]
    head += [f"{name} within, %" for name in estimators]
    head += ["images with a tag, %", "noise, median, pixels", "lasting noise, pixels", "predicted with it, %"]
    print(f"{room}, {tags} tags, odometry {odometry}, {drives} drives, detector {detector}\n")
    print(f"| {' | '.join(head)} |")
    print(f"|{' --- |' * len(head)}")
    for name in OBJECTIVES:
        of_it = problem_of(room, name, tags, odometry)
        deployment = placed(of_it, evaluations)
        found = problem.objective.poses(problem.evaluator, deployment, along)
        flights = [
            Flight(problem.evaluator, deployment, path, np.random.default_rng([7, i]))
            for i, path in enumerate(along.trajectories)
        ]
        recording = record(sensor, flights, noise)
        rng = np.random.default_rng(8)
        sigma = np.repeat([START[1], START[0]], 3)
        start = np.stack([path.poses[0] @ exp(sigma * rng.standard_normal(6)) for path in along.trajectories])
        trained = problem.objective.poses(problem.evaluator, deployment)
        shares = trained.known.mean(), found.known.mean(), predicted(found.covariances)
        texts = [name, *(f"{100 * share:.1f}" for share in shares)]
        for estimator in estimators.values():
            error = estimator.errors(recording, start).position
            by_drive = (error <= TOLERANCE).mean(axis=1)
            texts.append(f"{100 * by_drive.mean():.1f} +- {100 * by_drive.std(ddof=1) / np.sqrt(drives):.1f}")
        lasting = lasting_noise(corner_errors(recording))
        of_it = replace(problem.objective, pixel_noise=lasting)
        with_it = predicted(of_it.poses(problem.evaluator, deployment, along).covariances)
        texts += [f"{100 * (recording.visible_counts > 0).mean():.1f}", f"{np.median(recording.noise):.2f}"]
        texts += [f"{lasting:.2f}", f"{100 * with_it:.1f}"]
        print(f"| {' | '.join(texts)} |", flush=True)


def picture(room: str, tags: int, evaluations: int, path: Path) -> None:
    """Draw the standard deviation of the filtered position along one fresh drive for each deployment."""
    import matplotlib.pyplot as plt

    problem = problem_of(room, "filtered", tags)
    along = problem.objective.fresh
    figure, axes = plt.subplots(figsize=(9, 3.4), layout="constrained")
    drive = slice(along.first[3], along.first[4])
    for name in OBJECTIVES:
        found = problem.objective.poses(problem.evaluator, placed(problem_of(room, name, tags), evaluations), along)
        sigma = np.sqrt(found.covariances[:, [0, 3, 5]].sum(axis=1))
        axes.plot(
            along.trajectories[3].time, 1e3 * sigma[drive], label=f"{name}: {found.known.mean():.0%} of all drives"
        )
    axes.axhline(1e3 * TOLERANCE, color="grey", linestyle="--", label="tolerance")
    axes.set(xlabel="time [s]", ylabel="sigma of the position [mm]", yscale="log")
    axes.set_title(f"{room}, {tags} tags: filtered pose along a drive that was not optimised on")
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Run a part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=("moves", "shares", "flown", "picture"))
    parser.add_argument("room", nargs="?", choices=ROOMS, default="lab")
    parser.add_argument("file", nargs="?", type=Path, default=Path("filtered.png"))
    parser.add_argument("--tags", type=int, default=6)
    parser.add_argument("--evaluations", type=int, default=20000, help="of annealing for each deployment")
    parser.add_argument("--drives", type=int, default=40)
    parser.add_argument("--detector", default="noisy")
    parser.add_argument("--odometry", default="slow")
    given = parser.parse_args()
    if given.part == "moves":
        moves()
    elif given.part == "shares":
        shares(given.room, given.evaluations)
    elif given.part == "flown":
        flown(given.room, given.tags, given.evaluations, given.drives, given.detector, given.odometry)
    else:
        picture(given.room, given.tags, given.evaluations, given.file)


if __name__ == "__main__":
    main()
