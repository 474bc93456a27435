"""Papers hang wholly on their wall and never overlap: in starts, files, and whatever an optimiser returns."""

import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.paper import paper_camera, paper_room, paper_scene
from support.strategies import rooms, seeds
from support.thorough import examples

from lmd.core.checks import InputError
from lmd.formats.tag_maps import FileDeployment
from lmd.objectives.coverage import Coverage
from lmd.objectives.localisation import Localisation
from lmd.objectives.sampling import Sampling
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.genetic import EGA, RandomSearch
from lmd.optimisers.greedy import Greedy, GreedyDeployment
from lmd.problem import Problem
from lmd.run import evaluate, optimise
from lmd.scene import pdf
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.footprints import Footprints
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.models.fiducial import Fiducial
from lmd.sight.models.paper import Visibility
from lmd.space.cuboid import Cuboid

pytestmark = pytest.mark.slow  # images, or kernels of a second model of sight

EDGE = 0.3
TAG = Tag(EDGE / 1.25)  # its paper is 30 cm wide


def problem_of(start, visibility=None, sampling=None):
    room, angles = paper_room(spacing=1.5), pdf.grid_with_ends(6)
    scene = Scene(room, paper_camera(), angles, visibility or Visibility(thold=0.28), TAG)
    # What tags are seen by is compiled for localisation, as commands are.
    objective = Localisation(tolerance=0.2, sampling=None) if visibility else Coverage(2, 0.4, sampling)
    return Problem(scene, objective, start, threads=1)


def overlaps(deployment, room, edge):
    """By brute force: pairs on one surface that overlap, and footprints that are not wholly on theirs."""
    found, edge = [], np.broadcast_to(edge, len(deployment))
    for s, surface in enumerate(room.surfaces()):
        on = np.flatnonzero(deployment.surfaces == s)
        a, b = ((deployment.positions[on] - surface.origin) @ way for way in (surface.u, surface.v))
        ends = zip((a, b), surface.extent, strict=True)
        found += [
            on[i] for at, extent in ends for i in np.flatnonzero(abs(at - extent / 2) > (extent - edge[on]) / 2 + 1e-9)
        ]
        found += [
            (on[i], on[j])
            for i in range(len(on))
            for j in range(i)
            if max(abs(a[i] - a[j]), abs(b[i] - b[j])) < (edge[on[i]] + edge[on[j]]) / 2 * (1.0 - 1e-8)
        ]
    return found


@examples(60)
@given(
    room=rooms(),
    edges=st.lists(st.floats(0.02, 0.5), min_size=1, max_size=4, unique=True),
    count=st.integers(1, 30),
    fixed=st.integers(0, 3),
    seed=seeds,
)
def test_footprints_of_all_sizes_are_pushed_apart_or_there_is_no_room(room, edges, count, fixed, seed):
    footprints = Footprints(room, Tag(0.3, quiet_zone=0.5, edges=edges))
    drawn = RandomDeployment(count).draw(footprints.hanging, np.random.default_rng(seed), footprints.tag)
    papers = footprints.papers(drawn)
    np.testing.assert_allclose(papers[: len(edges)], 1.125 * np.array(edges)[:count])
    apart = footprints.separated(drawn)
    if apart is None:
        assert (papers**2).sum() > sum(surface.area for surface in room.surfaces()) / 16
        return
    assert not overlaps(apart, room, papers)
    footprints.check(apart)
    np.testing.assert_array_equal(apart.edges, drawn.edges)
    assert (room.surfaces_of(apart.positions, apart.normals) >= 0).all()
    again = footprints.separated(apart)
    np.testing.assert_array_equal(again.positions, apart.positions)
    # Those that hang already stay, and the others make room for them, too.
    fixed = min(fixed, count)
    stays = apart[:fixed] + drawn if fixed else drawn
    if (beside := footprints.separated(stays, fixed=fixed)) is not None:
        np.testing.assert_array_equal(beside.positions[:fixed], apart.positions[:fixed])
        assert not overlaps(beside, room, footprints.papers(beside))
    taken = footprints.touched(apart, apart[:1])
    assert taken.tolist() == [True] + [False] * (count - 1)


def test_a_plate_goes_to_the_nearest_free_place():
    room = paper_room()
    footprints, wall = Footprints(room, Tag(0.3, quiet_zone=0.0)), room.surfaces()[0]
    at = np.array([[2.0, 2.0], [2.1, 2.05], [2.2, 2.0], [1.0, 1.0]])
    start = Deployment(wall.point(*at.T), np.tile(wall.normal, (4, 1)), np.zeros(4, dtype=int))
    found = footprints.separated(start)
    np.testing.assert_allclose(
        np.stack(wall.coordinates(found.positions), axis=1), [[2.0, 2.0], [2.3, 2.05], [2.3, 1.75], [1.0, 1.0]]
    )
    np.testing.assert_array_equal(found.positions[[0, 3]], start.positions[[0, 3]])


def test_tags_at_one_point_are_pushed_to_the_nearest_places_without_delay():
    """600 papers at a point, as in the middle of a problem's box, took minutes."""
    size, count = 0.3, 40
    footprints = Footprints(Cuboid((20.0, 20.0, 20.0), (1.0, 1.0, 1.0), 1.0), Tag(size, quiet_zone=0.0))
    wall = footprints.room.surfaces()[0]
    stacked = Deployment(*(np.tile(each, (600, 1)) for each in (wall.point(9.0, 7.0), wall.normal)), np.zeros(600, int))
    began = time.process_time()
    found = np.stack(wall.coordinates(footprints.separated(stacked).positions), axis=1)
    assert time.process_time() - began < 20.0  # half a second, and some for the compiler
    for k in range(1, count):  # by brute force: of all places beside earlier papers the nearest
        lines = [np.unique(np.append(found[:k, i, None] + [-size, size], at)) for i, at in enumerate((9.0, 7.0))]
        places = np.stack(np.meshgrid(*lines), axis=-1).reshape(-1, 2)
        free = (np.abs(places[:, None] - found[:k]).max(axis=-1) > size - 1e-6).all(axis=1)
        away = np.linalg.norm(places - [9.0, 7.0], axis=1)
        assert np.linalg.norm(found[k] - [9.0, 7.0]) == pytest.approx(away[free].min())


def test_points_are_left_alone():
    scene = paper_scene()
    drawn = RandomDeployment(90).draw(scene.room, np.random.default_rng(0))
    assert scene.footprints.hanging is scene.room
    np.testing.assert_array_equal(scene.footprints.separated(drawn).positions, drawn.positions)
    stacked = Deployment(drawn.positions[[0, 0]], drawn.normals[[0, 0]], drawn.surfaces[[0, 0]])
    scene.footprints.check(stacked)


METHODS = {
    "annealing": Annealing,
    "annealing on samples": Annealing,
    "greedy": lambda: Greedy(spacing=0.5),
    "ega": EGA,
    "ega, paper's encoding": lambda: EGA(encoding="paper"),
    "random search": RandomSearch,
}


WALK = pytest.mark.thorough("lmd/scene", "lmd/optimisers", "lmd/incremental")  # compiled for it alone


@pytest.mark.parametrize(
    "method", [pytest.param(method, marks=WALK if "annealing" in method else ()) for method in METHODS]
)
@pytest.mark.parametrize("start", [RandomDeployment, UniformDeployment])
def test_no_optimiser_returns_plates_that_overlap(start, method):
    """Every second combination sees tags."""
    sees_tags = (list(METHODS).index(method) + (start is RandomDeployment)) % 2
    sampling = Sampling(2, 6) if "samples" in method else None
    problem = problem_of(start(40), Fiducial(TAG) if sees_tags else None, sampling)
    for draw in range(3):
        assert not overlaps(problem.draw(np.random.default_rng(draw)), problem.scene.room, EDGE)
    result = optimise(problem, evaluations=100, optimiser=METHODS[method]())
    assert not overlaps(result.deployment, problem.scene.room, EDGE)
    assert problem.fitness_of(result.deployment) == result.fitness
    assert evaluate(problem, result.deployment.with_surfaces(problem.scene.room))["fitness"] == result.fitness


def test_greedy_chooses_no_plates_that_overlap():
    problem = problem_of(RandomDeployment(40))
    start = GreedyDeployment(40, problem.scene, problem.objective, spacing=0.25, threads=1)
    assert not overlaps(start.draw(problem.scene.room, np.random.default_rng(0)), problem.scene.room, EDGE)
    with pytest.raises(
        InputError, match=r"^spacing = 0\.\d+ leaves room for \d+ footprints of 0\.3 m, too few for 900"
    ):
        GreedyDeployment(900, problem.scene, problem.objective, threads=1).draw(problem.scene.room, None)


def test_files_and_counts_that_cannot_be_are_refused(tmp_path):
    scene, path = problem_of(UniformDeployment(40)).scene, tmp_path / "tags.csv"
    start = UniformDeployment(12).draw(scene.room, np.random.default_rng())
    at = start.positions.copy()
    at[5] = at[4] + [0.0, 0.1, 0.29] if start.normals[4][0] else at[4] + [0.1, 0.0, 0.29]
    beyond = at.copy()
    beyond[5, 2] = 5.9

    def of(positions, **options):
        Deployment(positions, start.normals).to_csv(path)
        return FileDeployment(str(path), **options)

    as_they_are, tilted = problem_of(of(at, free=True)), EGA()
    np.testing.assert_array_equal(as_they_are.draw(np.random.default_rng(0)).positions, at)
    tilted.flush = False
    overlap = "landmarks 4 and 5 on y_min overlap"

    def tagged(tag, count):
        return Problem(replace(scene, tag=tag), Coverage(2, 0.4), UniformDeployment(count))

    for call, message in (
        (lambda: problem_of(of(at)), rf"^{path}: {overlap}: their papers are 0\.3 m wide, their centres 0\.29 m apart"),
        (lambda: optimise(as_they_are, evaluations=50), f"^{overlap}"),
        (lambda: evaluate(problem_of(UniformDeployment(40)), Deployment(at, start.normals)), f"^{overlap}"),
        (
            lambda: problem_of(of(beyond)),
            "m wide, which extends beyond y_min or beyond the part of this surface where tags may hang",
        ),
        (lambda: problem_of(RandomDeployment(3000)), r"^count = 3000 tags do not fit: the surfaces hold"),
        (lambda: tagged(Tag(0.1, "16h5"), 40), "^family 16h5 has 30 different tags, too few for 40"),
        (lambda: tagged(Tag(5.0), 4), r"^edge is too large: surface x_min is 5 m wide, too narrow for footprints of 6"),
        (lambda: optimise(problem_of(RandomDeployment(10)), evaluations=5, optimiser=tilted), "^flush must be true if"),
    ):
        with pytest.raises(InputError, match=message):
            call()


def test_a_visibility_about_another_tag_is_refused():
    scene = paper_scene()
    with pytest.raises(InputError, match=r"^tag is Tag\(edge=0\.2"):
        Scene(scene.room, scene.camera, scene.pdf, Fiducial(Tag(0.1)), Tag(0.2))
    assert Scene(scene.room, scene.camera, scene.pdf, Fiducial(Tag(0.1))).tag == Tag(0.1)
