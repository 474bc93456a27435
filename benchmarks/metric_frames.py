"""Scale of a model of other programs by rendered photographs, where it is known.

PYTHONPATH=tests python benchmarks/metric_frames.py [--seeds 40] [--picture FILE]

In each room 16 tags hang 1 mm and 2 mrad beside their map, and a camera with its calibration takes 30 photographs, of
which a real detector reads the tags. The model has the true poses with errors of 3 mm and 2 mrad, in another frame, of
which 1 unit is 1.7 m; 3 of its images are wholly wrong. It is written as COLMAP's text here, without code of `lmd`.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from support import walks

from lmd.core.checks import FloatArray
from lmd.detection.corner_errors import CORNER_ERRORS
from lmd.detection.detectors import AprilTagDetector
from lmd.detection.photographed import detected_in_photographs
from lmd.formats.reconstructions import read_model
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import exp
from lmd.localise.alignment import align
from lmd.localise.fixed_map import FixedMap
from lmd.localise.localise import localise
from lmd.scene.tag import Tag

CAMERA = Camera(2.2, 0.0048, 0.0048, (400.0, 300.0), 800, 600, 0.0)
SCALE, EDGE, TAGS, FRAMES, WRONG = 1.7, 0.2, 16, 30, 3
SIGMAS = np.repeat([0.002, 0.001], 3)  # of the map: rad and metres
TURN, PLACE = 0.002, 0.003  # of the model: rad and metres


def colmap(folder: Path, frames: FloatArray, rng: np.random.Generator) -> set[int]:
    """Write the model of images from poses `(n, 4, 4)`; return the indices of those that are wrong."""
    folder.mkdir(parents=True)
    turn, shift = Rotation.random(random_state=rng), rng.normal(0.0, 5.0, 3)
    lines, wrong = [], set(rng.choice(len(frames), WRONG, replace=False).tolist())
    for k, pose in enumerate(frames):
        own = Rotation.from_matrix(pose[:3, :3]) * Rotation.from_rotvec(rng.normal(0.0, TURN, 3))
        place = pose[:3, 3] + rng.normal(0.0, PLACE, 3)
        if k in wrong:
            own, place = Rotation.random(random_state=rng), place + rng.normal(0.0, 1.0, 3)
        back = (turn * own).inv()
        x, y, z, w = back.as_quat()
        row = [w, x, y, z, *(-back.apply(turn.apply(place) / SCALE + shift))]
        lines += [" ".join(map(str, [k + 1, *row, 1, f"{k:04d}.png"])), ""]
    (folder / "images.txt").write_text("\n".join([*lines, ""]))
    (folder / "cameras.txt").write_text("1 PINHOLE 800 600 458.33 458.33 400 300\n")
    (folder / "points3D.txt").write_text("")
    return wrong


def case(seed: int) -> tuple[dict[str, float], bool]:
    """Figures of the alignment in one room; and whether the images that do not fit are those that are wrong."""
    rng = np.random.default_rng(seed)
    plan = walks.spaced_tags(TAGS, rng)
    true, frames = plan @ exp(rng.normal(size=(TAGS, 6)) * SIGMAS), walks.walk(FRAMES, rng)
    tag, detector = Tag(EDGE), AprilTagDetector()
    known = FixedMap(np.arange(TAGS), plan, np.full(TAGS, EDGE), np.tile(SIGMAS, (TAGS, 1)))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        walks.photograph(folder / "photos", true, np.arange(TAGS), frames, CAMERA, EDGE, seed=seed)
        wrong = colmap(folder / "model", frames, rng)
        seen = detected_in_photographs(folder / "photos", [CAMERA], detector, tag.modules, map)
        result = localise(seen, [CAMERA], tag, CORNER_ERRORS["apriltag"], known)
        files, figures, _ = align(read_model(folder / "model"), result)
    table = files["alignment.csv"]
    astray = {int(name[:4]) for name, fits in zip(table["image"], table["fits"], strict=True) if not fits}
    present = {int(name[:4]) for name in table["image"]}
    return figures, astray == wrong & present


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args()
    found, named = zip(*(case(seed) for seed in range(options.seeds)), strict=True)
    scale, sigma = (np.array([one[name] for one in found]) for name in ("scale", "scale_sigma"))
    off = (scale - SCALE) / sigma
    shares = ", ".join(f"{(np.abs(off) <= k).mean():.1%}" for k in (1, 2, 3))
    print("| within 1, 2, 3 sigma | error / sigma | sigma | wrong images named |")
    print("| --- | --- | --- | --- |")
    print(f"| {shares} | {off.std():.2f} | {np.median(sigma / scale):.3%} | {np.mean(named):.1%} |")
    if options.picture is not None:
        import matplotlib.pyplot as plt

        figure, axes = plt.subplots(figsize=(8.0, 3.2), layout="constrained")
        axes.errorbar(range(len(off)), scale, 3.0 * sigma, fmt="o", markersize=3, linewidth=1, color="#1f6f8b")
        axes.axhline(SCALE, color="#c1440e", linewidth=1)
        axes.set_xlabel("room")
        axes.set_ylabel("metres per unit (bars: 3 sigma)")
        figure.savefig(options.picture, dpi=100)


if __name__ == "__main__":
    main()
