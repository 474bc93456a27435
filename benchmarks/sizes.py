"""How many views of the lab have a face of the room within the range of tags of some sizes.

    python benchmarks/sizes.py

Positions are random; the way to the face is that along the optical axis, the range that of a tag that faces the camera.
"""

import numpy as np
from hydra import compose, initialize_config_dir

from lmd.evaluation.reach import reach
from pipelines.app import CONF
from pipelines.building import build_problem

EDGES = (0.05, 0.06, 0.07, 0.08, 0.10, 0.12, 0.15)
POSITIONS = 2000


def main() -> None:
    """Print a line for each edge."""
    with initialize_config_dir(CONF, version_base="1.3"):
        scene = build_problem(compose("optimise", ["experiment=lab"])).scene
    positions = scene.room.sample(POSITIONS, np.random.default_rng(0))
    axes, probability = scene.orientations.axes[:, :3], scene.probability(positions)
    with np.errstate(divide="ignore", invalid="ignore"):
        ways = (np.where(axes > 0.0, scene.room.size, 0.0) - positions[:, None]) / axes
    way = np.where(axes == 0.0, np.inf, ways).min(axis=-1)
    for edge in EDGES:
        farthest = reach(scene.sized(np.array([edge])).visibility, scene.single_camera("this"), 0.0).farthest
        share = ((way <= farthest) * probability).sum(axis=1).mean()
        print(f"{edge:g} m: read from up to {farthest:.2f} m, which is enough for {share:.1%} of views")


if __name__ == "__main__":
    main()
