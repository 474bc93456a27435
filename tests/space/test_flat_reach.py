"""A camera that is always at one height, as on a robot on the ground."""

import numpy as np

from lmd.space.floor_plan import FloorPlan
from lmd.space.parts import Reachable
from lmd.space.prism import Prism


def test_positions_are_drawn_over_a_plane_as_over_a_volume():
    room = Prism(FloorPlan([[0, 0], [4, 0], [4, 3], [0, 3]], 2.5), Reachable((0.5, 0.5), 0.25), 0.5)
    rng = np.random.default_rng(0)
    for points in (room.grid(), room.jittered_grid(2, rng), room.sample(500, rng), room.sample_evenly(500, rng)):
        assert (points[:, 2] == 0.5).all()
        np.testing.assert_allclose(points[:, :2].mean(axis=0), [2.0, 1.5], atol=0.15)
        assert np.ptp(points[:, 0]) > 2.9
