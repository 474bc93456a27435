import math

import numpy as np
import pytest
from contracts.criterion import check_counts
from numpy.testing import assert_array_equal
from support.paper import chances, facing, one_position_room, paper_scene

from lmd.geometry.frames import optical_axis
from lmd.scene import pdf
from lmd.scene.criteria import TOLERANCE
from lmd.scene.deployment import Deployment
from lmd.sight import reference
from lmd.sight.evaluator import Evaluator
from lmd.space.cuboid import Cuboid


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["upper", "lower"])
@pytest.mark.parametrize("rim", ["near limit", "field of view"])
def test_an_axis_on_the_rim_of_a_cap_counts_at_whatever_height_it_is(rim, side):
    # A micrometre from multiples of 1/256 of the unit sphere's radius, where a table of heights may have its edges.
    heights = (np.arange(-250, 251)[:, None] / 256.0 + np.array([0.0, -1e-6, 1e-6])).ravel()
    pitch, here = np.arcsin(heights), np.full(3, 2.0)
    orientations = pdf.OrientationPdf(np.zeros(len(pitch)), pitch, np.full(len(pitch), 1.0 / len(pitch)))
    scene = paper_scene(one_position_room(here), orientations=orientations, occlusion="none")
    if rim == "near limit":
        depth, away = scene.sight.min_depth, 1e-9  # the cap of a landmark at the near limit is a point
    else:
        depth, away = 2.0, math.acos(scene.sight.min_cosine)
    landmarks = here + depth * optical_axis(np.zeros(len(pitch)), pitch - side * away)
    check_counts(scene, facing(here, *landmarks), 1)


@pytest.mark.parametrize(
    ("along", "across", "occlusion", "hides"),
    [
        (1.0, 0.05 * (1 + TOLERANCE), "paper", True),
        (1.0, math.nextafter(0.05 * (1 + TOLERANCE), 1.0), "paper", False),
        (1.0, 0.05 * (1 + TOLERANCE), "line_of_sight", True),
        (1.0, math.nextafter(0.05 * (1 + TOLERANCE), 1.0), "line_of_sight", False),
        (2.0 + 2.0**-31, 0.0, "line_of_sight", True),
        (2.0 + 2.0**-28, 0.0, "line_of_sight", False),
        (2.0 + 2.0**-28, 0.0, "paper", True),
    ],
)
def test_the_last_place_from_which_a_landmark_hides_another(along, across, occlusion, hides):
    # The camera in the origin and landmarks on its axes: no rounding but that of the decision itself.
    room = Cuboid(size=(4.0, 4.0, 4.0), reachable_size=(4.0, 4.0, 4.0), spacing=4.0, positions="vertices")
    scene = paper_scene(room, orientations=pdf.OrientationPdf([0.0], [0.0], [1.0]), occlusion=occlusion)
    deployment = Deployment([[0.0, 2.0, 0.0], [across, along, 0.0]], [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
    counts = Evaluator(scene, threads=1).counts(deployment)
    assert counts[0, 0] == (not hides)
    assert_array_equal(counts, reference.counts(scene, deployment))


@pytest.mark.parametrize("build", [pdf.grid_with_ends, pdf.grid_of_cells, pdf.solid_angle])
@pytest.mark.parametrize("divisions", [1, 3, 4, 12, 24])
def test_a_camera_that_always_sees_a_landmark_has_probability_one(build, divisions):
    orientations, here = build(divisions), np.full(3, 3.0)
    scene = paper_scene(one_position_room(here), orientations=orientations, occlusion="none")
    (probability,) = chances(Evaluator(scene, threads=1), facing(here, *(here + 2.0 * orientations.axes)), 1)
    assert 1.0 - 1e-12 <= probability <= 1.0


# Signed permutations of the world axes, and what each does to yaw and pitch.
