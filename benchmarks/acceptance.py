"""Rates of false alarms and of found tags in the acceptance of a hung map, in rendered images.

python benchmarks/acceptance.py [--seeds S] [--reader aruco]

Stations are chosen for the deployment `uniform` of `experiment=lab`. For each seed all tags hang with random errors of
the stated standard deviations: once so, and once with one tag moved by the stated shift in a random direction of its
plane. At each station the camera is off by 1 cm and 1 degree (1 sigma), a detector reads the rendered image, OpenCV's
PnP reports the position by the map as planned, and the tape has normal errors. Prints a Markdown table of the shares of
maps in which a station fails, any tag is named, and the moved tag and no other tag is named. Some 1 S s of a processor.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from scipy.linalg import block_diag

from lmd.core.checks import BoolArray, FloatArray
from lmd.detection.frames import detect_in_frames
from lmd.evaluation.acceptance import PLACE, REPORTED, HungMap
from lmd.evaluation.mounting import MountedTags
from lmd.evaluation.rendered_corners import READERS, imaging_of
from lmd.evaluation.uncertainty import UncertaintyStudy
from lmd.geometry.pose import body_from_corners
from lmd.geometry.se3 import camera_pose
from lmd.geometry.squares import corners
from lmd.pipelines.app import CONF
from lmd.pipelines.building import build_problem
from lmd.pipelines.score import mounting_of
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom

PLACED, TURNED = 0.01, 1.0  # standard deviations with which the camera is put at a station, metres and degrees


def reported(
    hung: HungMap, mounted: MountedTags, by: FloatArray, poses: FloatArray, reader: str, seed: int
) -> tuple[BoolArray, FloatArray]:
    """Tags that a detector reads in rendered images, `(S, K)`, and the positions that PnP reports, `(S, 3)`.

    Args:
        hung: the map as planned.
        mounted: the tags as they hang.
        by: further shift of the tags, metres, `(K, 3)`.
        poses: poses of the camera, `(S, 4, 4)`.
        reader: name of the detector.
        seed: seed of the pixel noise.
    """
    scene, tags, tag, (camera,) = hung.problem.scene, hung.tags, hung.problem.scene.tag, hung.problem.scene.cameras
    edges, faces = tags.edges_of(tag), scene.room.faces()
    hanging = mounted.deployment.positions + by, mounted.deployment.normals, mounted.ups
    renderer = Renderer(camera, TaggedRoom(tag, tags.ids, *hanging, faces, edges), imaging_of(hung.problem))
    found = detect_in_frames(renderer, {reader: READERS[reader](tag.family)}, poses, 0, seed)[reader]
    images = np.where(found.detected[..., None, None], found.corners, np.nan)
    points = corners(tags.places, tags.normals, tags.ups, edges)
    at = [body_from_corners([camera], np.eye(4)[None], points, [image])[:3, 3] for image in images]
    return found.detected, np.array(at)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--reader", choices=list(READERS), default="aruco")
    options = parser.parse_args()
    with initialize_config_dir(CONF, version_base="1.3"):
        cfg = compose("evaluate", ["studies=[acceptance]", "experiment=lab", "deployment=uniform"])
    problem, error, settings = build_problem(cfg), mounting_of(cfg), instantiate(cfg.acceptance)
    plan = problem.draw(np.random.default_rng(0))
    errors, _ = UncertaintyStudy(corners="rendered").errors(problem, plan, 0)
    hung = HungMap(problem, plan, errors, block_diag(*error.covariances(problem, plan)), settings)
    stations, _ = hung.chosen(0)
    rows: dict[str, list[tuple[bool, bool, bool]]] = {"correct": [], f"a tag moved by {settings.shift:g} m": []}
    for seed in range(options.seeds):
        rng = np.random.default_rng([seed, 1])
        mounted = error.draw(problem, plan, rng)
        at = stations[PLACE].to_numpy() + rng.normal(0.0, [PLACED, PLACED, PLACED, TURNED], (len(stations), 4))
        poses = camera_pose(at[:, :3], np.radians(at[:, 3]), settings.pitch)
        tape = rng.normal(0.0, settings.tape, (len(at), 3))
        moved, angle, by = int(rng.integers(len(plan))), rng.uniform(0.0, 2.0 * np.pi), np.zeros((len(plan), 3))
        for each in rows.values():
            read, told = reported(hung, mounted, by, poses, options.reader, seed)
            filled = stations.assign(**dict(zip(REPORTED, told.T, strict=True)))
            filled["tags"], filled[PLACE[:3]] = [" ".join(map(str, plan.ids[row])) for row in read], at[:, :3] + tape
            with tempfile.TemporaryDirectory() as folder:
                filled.to_csv(path := Path(folder, "stations.csv"), index=False)
                files, figures, _ = hung.judged(str(path))
            named = files["acceptance_tags.csv"].named
            alone = bool(named[moved] and named.sum() == 1)
            each.append((figures["stations_failed"] > 0.0, bool(named.any()), alone))
            along = hung.along[6 * moved : 6 * moved + 3, 2 * moved : 2 * moved + 2]
            by[moved] = settings.shift * (along @ [np.cos(angle), np.sin(angle)])  # of the second row
    print(f"{len(stations)} stations, {options.seeds} maps of {len(plan)} tags, {options.reader}\n")
    print("| map | a station fails | a tag is named | only the moved tag is named |\n| --- | --: | --: | --: |")
    for name, each in rows.items():
        shares = np.mean(each, axis=0)
        print(f"| {name} | {shares[0]:.1%} | {shares[1]:.1%} | {shares[2]:.1%} |")


if __name__ == "__main__":
    main()
