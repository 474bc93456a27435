"""PDFs that depend on the position, for property tests: every position has random probabilities of its own."""

from dataclasses import replace

import numpy as np
from hypothesis import strategies as st
from strategies import cameras, fiducial_scenes, scenes, seeds


def with_probabilities(scene, seed):
    """The scene with probabilities that `seed` and a position decide; some orientations never occur somewhere."""
    size = len(scene.pdf.weight)

    def at(positions):
        rows = []
        for position in np.asarray(positions):
            rng = np.random.default_rng([seed, *(np.abs(position) * 1e6).astype(np.uint64)])
            row = rng.random(size) * (rng.random(size) < 0.7) + 1e-3 * (np.arange(size) == rng.integers(size))
            rows.append(row / row.sum())
        return np.array(rows)

    return replace(scene, pdf=replace(scene.pdf, by_position=at, continuous=None, refine=None))


plain_scenes = st.builds(with_probabilities, scenes(), seeds)
tag_scenes = st.builds(with_probabilities, fiducial_scenes(cameras()), seeds)
varied_scenes = st.one_of(plain_scenes, tag_scenes)
