"""Range of a visibility model: leaving out landmarks beyond it changes no count."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numba import njit
from support.paper import chances, paper_camera, paper_scene
from support.strategies import (
    cameras,
    distorted_cameras,
    fiducials,
    pdfs,
    rolled_pdfs,
    seeds,
    unit_vectors,
    visibilities,
    with_probabilities,
)
from support.thorough import examples
from test_fiducial import check_paths

from lmd.scene.criteria import from_position, horizon_of
from lmd.scene.deployment import NORMAL_TOLERANCE, Deployment
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight import reference
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.fiducial import Fiducial
from lmd.sight.models.limits import Limits
from lmd.sight.models.paper import Visibility
from lmd.sight.viewpoint import REGION, box_around, gather
from lmd.space.cuboid import Cuboid


@st.composite
def halls(draw):
    """Much larger than most cameras see, with several blocks of positions."""
    length, width = draw(st.floats(10.0, 80.0)), draw(st.floats(10.0, 80.0))
    return Cuboid((length, width, 5.0), (0.9 * length, 0.9 * width, 0.5), (length / 8.0, width / 6.0, 0.5))


def any_scene(room):
    return st.one_of(
        st.builds(Scene, room, cameras(), pdfs, visibilities()),
        st.builds(Scene, room, st.one_of(cameras(), distorted_cameras()), rolled_pdfs(), fiducials()),
    )


@examples(40)
@given(scene=any_scene(halls()), n=st.integers(1, 3), seed=seeds)
def test_in_a_hall_every_fast_path_counts_what_the_reference_does(scene, n, seed):
    rng = np.random.default_rng(seed)
    drawn, targets = (RandomDeployment(count).draw(scene.room, rng) for count in (30, 6))
    # Some stand before others, and hide them.
    before = drawn.positions[:10] + 0.1 * drawn.normals[:10] + rng.normal(scale=0.05, size=(10, 3))
    normals = np.vstack([drawn.normals, drawn.normals[:10]])
    check_paths(scene, Deployment(np.vstack([drawn.positions, before]), normals), targets, n, rng)


@pytest.fixture(scope="module")
def hall():
    """A scene, landmarks in it and what the reference counts of them."""
    room = Cuboid((62.0, 22.0, 4.0), (60.0, 20.0, 0.5), (1.5, 1.5, 0.5))
    scene = with_probabilities(paper_scene(room, occlusion="line_of_sight"), 0)
    drawn = RandomDeployment(200).draw(room, np.random.default_rng(0))
    return scene, drawn, reference.counts(scene, drawn)


@pytest.mark.parametrize("threads", [1, 2, 3, 5])
def test_regions_that_see_other_landmarks_count_what_the_reference_does(hall, threads):
    """Several of them, cut by threads anywhere, with positions in any order that have weights of their own."""
    scene, drawn, counts = hall
    grid = scene.room.grid()
    shuffled = np.random.default_rng(1).permutation(len(grid))
    evaluator = Evaluator(scene, grid[shuffled], threads)
    assert len(grid) > 2 * REGION
    order, horizon = evaluator.blocks[0][: len(grid)], horizon_of(scene.sight)
    corners = [box_around(evaluator.positions, order[o : o + REGION]) for o in range(0, len(grid), REGION)]
    poses, names = np.vstack([drawn.positions.T, drawn.normals.T]), np.arange(200)
    near = [gather(*corner, horizon, 200, poses, names, np.empty((6, 200)), np.empty(200, int)) for corner in corners]
    assert max(near) < 200
    expected = counts[shuffled]
    np.testing.assert_array_equal(evaluator.counts(drawn), expected)
    for n in (1, 2):
        wanted = reference.coverage_probability(expected, scene.pdf, n, grid[shuffled])
        np.testing.assert_allclose(chances(evaluator, drawn, n), wanted, atol=1e-12)


@njit(error_model="numpy")
def _is_reached(sight, offset, normal):
    return from_position(sight, (offset[0], offset[1], offset[2]), (normal[0], normal[1], normal[2]), 0.0)[0]


@given(
    camera=st.one_of(cameras(), distorted_cameras()),
    criteria=st.one_of(visibilities(), fiducials()),
    way=unit_vectors,
    normal=unit_vectors,
    further=st.floats(1e-9, 10.0),
)
def test_nothing_beyond_the_horizon_is_reached(camera, criteria, way, normal, further):
    sight = criteria.sight(camera).unhidden()  # then the horizon has no room for what hides
    horizon = horizon_of(sight)
    assume(math.isfinite(horizon))
    for facing in (normal, -way, -(1.0 + NORMAL_TOLERANCE) * way):
        assert not _is_reached(sight, horizon * (1.0 + further) * way, facing)


@pytest.mark.parametrize("occlusion", ["line_of_sight", "none"])
def test_the_papers_horizon_is_where_the_cone_of_view_leaves_the_greatest_depth(occlusion):
    camera, nu = paper_camera(), 0.05
    visibility = Visibility(thold=0.28, nu=nu, occlusion=occlusion)
    depth = camera.resolution_depth(0.28)
    corner = depth / math.cos(camera.cone_half_angle)
    beyond = nu if occlusion == "line_of_sight" else 0.0
    assert horizon_of(visibility.sight(camera)) == pytest.approx(corner + beyond, rel=1e-6)


def test_a_detector_that_needs_no_pixels_has_no_horizon():
    fiducial = Fiducial(
        Tag(0.1, "36h11", 1.0), limits=Limits(pitch=0.0, blur=0.0, edge=0.0, incidence=60.0, margin=0.0)
    )
    assert horizon_of(fiducial.sight(paper_camera())) == math.inf


def test_who_hides_from_any_distance_has_no_horizon():
    assert horizon_of(paper_scene().sight) == math.inf
