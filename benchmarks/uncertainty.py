"""How far predicted deviations of a pose hold.

python benchmarks/uncertainty.py [--frames F] [--seeds S | --rules | --simulated]

Prints Markdown tables for the deployment `uniform` of `experiment=lab`:

1. normalised errors (NEES over its degrees of freedom) of PnP on F rendered frames that a detector reads, for tags that
   are not cut by the border; with the corner errors of the library's table, and with those measured on F other frames;
   with `--seeds S`, of S seeds, with the errors that the command takes by default; the scatter is the standard
   deviation of the NEES over that of chi-square, and gives wider bounds if errors have longer tails than normal ones;
2. with `--simulated`: normalised errors under normal noise of half a pixel in F views, by the predicted deviation;
3. with `--rules`: quantiles of the standard deviation over its law and over the usual rules.

Some 40 F ms of a processor for each detector.
"""

import argparse
from itertools import pairwise

import numpy as np
from hydra import compose, initialize_config_dir
from scipy.stats import chi2, norm

from lmd.core.checks import FloatArray
from lmd.detection.corner_errors import CORNER_ERRORS, CornerErrors, MeasuredCorners
from lmd.detection.frames import detect_in_frames, draw_poses, tagged_room
from lmd.estimation.pose_covariance import TagErrors, pose_covariances
from lmd.evaluation.rendered_corners import BORDER, READERS, imaging_of, measured_corners
from lmd.evaluation.uncertainty import UncertaintyStudy, uncertainty
from lmd.evaluation.uncertainty_law import uncertainty_law
from lmd.geometry.pose import body_from_corners
from lmd.geometry.projection import image_size, project
from lmd.geometry.se3 import axis_and_right, inverse, log
from lmd.geometry.squares import corners
from lmd.pipelines.app import CONF
from lmd.pipelines.building import build_problem
from lmd.problem import Problem
from lmd.render.renderer import Renderer
from lmd.scene.deployment import Deployment
from lmd.sight.views import visible_to_each

SEED, LEVEL, LEAST = 3, 0.99, 2
READERS_TRIED = ("aruco", "apriltag")
PARTS = {"pose": (slice(None), 6), "rotation": (slice(3), 3), "position": (slice(3, 6), 3)}
RULES = ("law", "one law", "squared", "photonvision", "constant")


def lab() -> tuple[Problem, Deployment]:
    """The problem of `experiment=lab` and its uniform deployment."""
    with initialize_config_dir(CONF, version_base="1.3"):
        problem = build_problem(compose("evaluate", ["experiment=lab", "deployment=uniform"]))
    return problem, problem.draw(np.random.default_rng(0))


def normalised(
    problem: Problem,
    tags: Deployment,
    reader: str,
    noises: dict[str, CornerErrors | MeasuredCorners],
    frames: int,
    seed: int = SEED + 1,
) -> dict[str, FloatArray]:
    """NEES of pose, rotation and position `(F, 3)` by the name of the noise, with and without tags at the border."""
    scene, camera, tag = problem.scene, problem.scene.cameras[0], problem.scene.tag
    poses = draw_poses(scene, 20 * frames, seed)
    seen = visible_to_each(problem.evaluator, tags, poses[:, :3, 3], axis_and_right(poses))[0]
    poses = poses[seen.sum(axis=1) >= LEAST][:frames]
    points = corners(tags.places, tags.normals, tags.ups, tags.edges_of(tag))
    renderer = Renderer(camera, tagged_room(scene.room, tags, tag), imaging_of(problem))
    found = detect_in_frames(renderer, {reader: READERS[reader](tag.family)}, poses, 0, seed)[reader]
    image = project(camera, poses, points.reshape(-1, 3)).reshape(len(poses), *points.shape[:2], 2)
    with np.errstate(invalid="ignore"):
        clear = ((image > BORDER) & (image < np.array(image_size(camera)) - BORDER)).all(axis=(2, 3))
    every = {"": found.detected & clear, " with tags at the border": found.detected}
    nees: dict[str, FloatArray] = {}
    for label, mask in every.items():
        enough = np.flatnonzero(mask.sum(axis=1) >= LEAST)
        body = [camera], np.eye(4)[None]
        errors = {
            f: log(inverse(poses[f]) @ body_from_corners(*body, points[mask[f]], [found.corners[f][mask[f]]]))
            for f in enough
        }
        for name, noise in noises.items():
            model = TagErrors(noise, 0.0, np.zeros((len(tags), 6, 6)))
            covariances, *_ = pose_covariances([camera], np.eye(4)[None], poses, tags, tag, mask[None], model)
            blocks = [own for own, _ in PARTS.values()]
            pairs = [(errors[f], covariances[f]) for f in enough]
            nees[name + label] = np.array([[e[b] @ np.linalg.solve(c[b, b], e[b]) for b in blocks] for e, c in pairs])
    return nees


def print_normalised(frames: int) -> None:
    """Print table 1."""
    problem, tags = lab()
    print("| detector | corner errors | frames | part | mean / dof | 99 % bounds | below 90 % | below 99 % |")
    print("| --- | --- | ---: | --- | ---: | --- | ---: | ---: |")
    for reader in READERS_TRIED:
        noises = {"table": CORNER_ERRORS[reader], "rendered": measured_corners(problem, tags, reader, frames, SEED)}
        for name, nees in normalised(problem, tags, reader, noises, frames).items():
            for column, (part, (_, freedom)) in zip(nees.T, PARTS.items(), strict=True):
                low, high = bounds(freedom, len(column))
                below = [(column < chi2.ppf(level, freedom)).mean() for level in (0.9, 0.99)]
                print(
                    f"| {reader} | {name} | {len(column)} | {part} | {column.mean() / freedom:.3f} | {low:.3f} to "
                    f"{high:.3f} | {below[0]:.1%} | {below[1]:.1%} |"
                )


def print_seeds(seeds: int, frames: int) -> None:
    """Print table 1b: the default, and the table of the detector, with frames and their corners of several seeds."""
    problem, tags = lab()
    head = "| detector | corner errors | part | mean / dof, each seed | mean | 99 % bounds of one seed | inside |"
    print(f"{head} scatter | inside by scatter |\n| --- | --- | --- | --- | ---: | --- | ---: | ---: | ---: |")
    for reader in READERS_TRIED:
        rows: dict[tuple[str, str], list[tuple[float, ...]]] = {}
        for seed in range(seeds):
            measured = measured_corners(problem, tags, reader, UncertaintyStudy().frames, seed)
            noises = {"default": measured, "table": CORNER_ERRORS[reader]}
            found = normalised(problem, tags, reader, noises, frames, SEED + 1 + seed)
            for name in noises:
                for column, (part, (_, freedom)) in zip(found[name].T, PARTS.items(), strict=True):
                    mean, spread = column.mean() / freedom, column.std(ddof=1) / freedom
                    reach = norm.ppf((1.0 + LEVEL) / 2.0) * spread / np.sqrt(len(column))
                    scatter, own = spread / np.sqrt(2.0 / freedom), abs(mean - 1.0) < reach
                    rows.setdefault((name, part), []).append((mean, *bounds(freedom, len(column)), scatter, own))
        for (name, part), each in rows.items():
            means, low, high, scatter, own = np.array(each).T
            texts = [" ".join(f"{mean:.2f}" for mean in means), f"{means.mean():.2f}"]
            texts += [f"{low.mean():.2f} to {high.mean():.2f}", f"{((low < means) & (means < high)).sum()} of {seeds}"]
            texts += [f"{scatter.mean():.2f}", f"{own.sum():.0f} of {seeds}"]
            print(f"| {reader} | {name} | {part} | {' | '.join(texts)} |", flush=True)


def bounds(freedom: int, count: int) -> FloatArray:
    """Bounds of the mean of `count` normalised errors over their degrees of freedom, `(2,)`."""
    total = freedom * count
    return np.asarray(chi2.ppf([(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0], total) / total)


def print_simulated(views: int) -> None:
    """Print table 2."""
    problem, tags = lab()
    scene, camera, tag, noise = problem.scene, problem.scene.cameras[0], problem.scene.tag, 0.5
    poses = draw_poses(scene, 20 * views, SEED)
    seen = visible_to_each(problem.evaluator, tags, poses[:, :3, 3], axis_and_right(poses))[0]
    enough = np.flatnonzero(seen.sum(axis=1) >= LEAST)[:views]
    poses, seen = poses[enough], seen[enough]
    model = TagErrors(noise, 0.0, np.zeros((len(tags), 6, 6)))
    covariances, *_ = pose_covariances([camera], np.eye(4)[None], poses, tags, tag, seen[None], model)
    points, rng = corners(tags.places, tags.normals, tags.ups, tags.edges_of(tag)), np.random.default_rng(SEED)
    nees = []
    for pose, mask, covariance in zip(poses, seen, covariances, strict=True):
        image = project(camera, pose, points[mask].reshape(-1, 3)).reshape(-1, 4, 2)
        image += rng.normal(0.0, noise, image.shape)
        e = log(inverse(pose) @ body_from_corners([camera], np.eye(4)[None], points[mask], [image]))
        nees.append([e[own] @ np.linalg.solve(covariance[own, own], e[own]) for own, _ in PARTS.values()])
    deviation = np.sqrt(np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2))
    print("| predicted deviation [m] | views | pose | rotation | position | 99 % bounds, pose | rotation, position |")
    print("| --- | ---: | ---: | ---: | ---: | --- | --- |")
    for low, high in pairwise((0.0, 0.05, 0.1, 0.2, 0.4, 10.0)):
        own = (deviation > low) & (deviation <= high)
        means = np.array(nees)[own].mean(axis=0) / [freedom for _, freedom in PARTS.values()]
        texts = " | ".join("{:.2f} to {:.2f}".format(*bounds(n, int(own.sum()))) for n in (6, 3))
        print(f"| {low:g} to {high:g} | {own.sum()} | {' | '.join(f'{m:.2f}' for m in means)} | {texts} |")


def print_rules() -> None:
    """Print table 3."""
    problem, tags = lab()
    print("| corners | quantity | rule | 5 % | 50 % | 95 % | factor of 90 % |")
    print("| --- | --- | --- | ---: | ---: | ---: | ---: |")
    for reader in READERS_TRIED:
        study = UncertaintyStudy(corners=reader)
        errors = uncertainty_law(uncertainty(problem, tags, study, SEED)).errors.set_index(["quantity", "rule"])
        for quantity in ("position", "rotation"):
            for rule in RULES:
                row = errors.loc[(quantity, rule)]
                numbers = " | ".join(f"{row[name]:.2f}" for name in ("5 %", "50 %", "95 %", "factor_90"))
                print(f"| {reader} | {quantity} | {rule} | {numbers} |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=400, help="number of rendered frames")
    parser.add_argument("--simulated", action="store_true", help="print the errors under simulated noise")
    parser.add_argument("--rules", action="store_true", help="print the rules in place of the normalised errors")
    parser.add_argument("--seeds", type=int, default=0, help="print the normalised errors of several seeds")
    given = parser.parse_args()
    if given.seeds:
        print_seeds(given.seeds, given.frames)
    elif given.rules:
        print_rules()
    elif given.simulated:
        print_simulated(given.frames)
    else:
        print_normalised(given.frames)
