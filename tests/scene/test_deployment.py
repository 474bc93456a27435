import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chisquare, kstest
from support.paper import X, Y, Z, experiment_room, paper_room
from support.strategies import deployments, rooms, seeds
from support.tables import rows

from lmd.core.checks import InputError
from lmd.formats.tag_maps import FileDeployment
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import GivenDeployment, RandomDeployment, UniformDeployment

HEADER = "id,x,y,z,nx,ny,nz\n"


def uniform(count, room=None, **layout):
    return UniformDeployment(count, **layout).draw(room or paper_room(), np.random.default_rng(0))


def random(count, room=None, seed=0):
    return RandomDeployment(count).draw(room or paper_room(), np.random.default_rng(seed))


def per_wall(deployment, room):
    return [int((wall.normal == deployment.normals).all(axis=1).sum()) for wall in room.surfaces()]


def is_flush(deployment, room):
    walls = room.surfaces()
    return all(
        any((n == w.normal).all() and abs((s - w.origin) @ w.normal) < 1e-12 for w in walls)
        for s, n in zip(deployment.positions, deployment.normals, strict=True)
    )


@pytest.mark.parametrize(
    ("normal", "grid"),
    [(X, (1, 3, 5)), (-X, (1, 3, 5)), (Y, (5, 1, 3)), (-Y, (5, 1, 3)), (Z, (5, 3, 1)), (-Z, (5, 3, 1))],
)
def test_ninety_uniform_landmarks_make_a_3_by_5_grid_of_cell_centres_on_each_wall(normal, grid):
    deployment, size = uniform(90), paper_room().size
    on_wall = deployment.positions[(deployment.normals == normal).all(axis=1)]
    assert len(on_wall) == 15
    for axis, n in enumerate(grid):
        wall_side = [0.0 if normal[axis] > 0 else size[axis]]
        expected = wall_side if n == 1 else size[axis] * (np.arange(n) + 0.5) / n
        assert_allclose(np.unique(np.round(on_wall[:, axis], 9)), expected)
    assert len(np.unique(on_wall, axis=0)) == 15


@given(rooms(), st.integers(1, 100), st.sampled_from(["per_wall", "by_area", "random"]), seeds)
def test_landmarks_are_as_many_as_asked_flush_inside_and_apart(room, count, layout, seed):
    deployment = random(count, room, seed) if layout == "random" else uniform(count, room, layout=layout)
    assert len(deployment) == count
    assert is_flush(deployment, room)
    assert (deployment.with_surfaces(room).surfaces >= 0).all()
    assert len(np.unique(np.hstack([deployment.positions, deployment.normals]), axis=0)) == count


@given(rooms(), st.integers(1, 100))
def test_counts_by_wall_differ_by_at_most_one_and_by_area_are_the_shares_rounded(room, count):
    counts, area = per_wall(uniform(count, room), room), np.array([wall.area for wall in room.surfaces()])
    assert max(counts) - min(counts) <= 1
    counts = per_wall(uniform(count, room, layout="by_area"), room)
    assert (np.abs(counts - count * area / area.sum()) < 1.0).all()


@pytest.mark.parametrize(("count", "expected"), rows(__file__, "tags by wall"))
def test_what_is_left_over_goes_to_the_largest_walls(count, expected):
    assert per_wall(uniform(count), paper_room()) == expected


def test_only_the_walls_of_the_room_carry_landmarks():
    room = experiment_room()
    for deployment in (uniform(80, room), random(80, room)):
        assert is_flush(deployment, room)
        assert (deployment.normals[:, 2] == 0.0).all()


def test_random_landmarks_are_shared_in_proportion_to_area():
    room = paper_room()
    area = np.array([wall.area for wall in room.surfaces()])
    counts = per_wall(random(6000, room, seed=1), room)
    assert chisquare(counts, 6000 * area / area.sum()).pvalue > 0.01


def test_random_landmarks_are_uniform_along_a_wall():
    deployment = random(3000, paper_room(walls=("y_max",)), seed=2)
    assert kstest(deployment.positions[:, 0] / 7.5, "uniform").pvalue > 0.01
    assert kstest(deployment.positions[:, 2] / 6.0, "uniform").pvalue > 0.01


@given(st.data())
def test_a_csv_round_trip_is_exact(tmp_path_factory, data):
    room = data.draw(rooms())
    deployment = data.draw(deployments(room))
    path = tmp_path_factory.mktemp("csv") / "landmarks.csv"
    deployment.to_csv(path)
    again = FileDeployment(str(path), len(deployment), free=True).draw(room, np.random.default_rng(0))
    assert_array_equal(again.positions, deployment.positions)
    assert_array_equal(again.normals, deployment.normals)


def test_the_csv_header_is_the_documented_one(tmp_path):
    uniform(2).to_csv(tmp_path / "landmarks.csv")
    assert (tmp_path / "landmarks.csv").read_text().splitlines()[:2] == [HEADER.strip(), "0,3.75,0.0,3.0,0.0,1.0,0.0"]


def test_the_id_column_may_be_absent_and_columns_may_come_in_any_order(write):
    deployment = Deployment.from_csv(write("nx,ny,nz,x,y,z\n0,0,1,1,2,0\n"))
    assert deployment.positions.tolist() == [[1.0, 2.0, 0.0]]
    assert deployment.normals.tolist() == [[0.0, 0.0, 1.0]]


def test_a_normal_printed_with_few_decimals_is_made_unit(write):
    deployment = Deployment.from_csv(write(HEADER + "0,1,1,0,0.577,0.577,0.577\n"))
    assert_allclose(deployment.normals, math.sqrt(1 / 3), rtol=1e-12)


def test_landmarks_that_do_not_hang_may_be_free(write):
    path = write(f"{HEADER}0,1,1,0,0,0,1\n1,7,4,1,-1,0,0\n2,7.5,4,1,1,0,0\n")
    assert len(FileDeployment(path, free=True).draw(paper_room(), np.random.default_rng(0))) == 3


def test_landmarks_may_be_measured_by_hand(write):
    path = write(f"{HEADER}0,7.48,4,1,-1,0,0\n1,7.5,3,1,-1,0,0\n", "landmarks.csv")
    drawn = FileDeployment(path).draw(paper_room(), np.random.default_rng(0))
    assert drawn.surfaces[0] == -1 != drawn.surfaces[1]
    with pytest.raises(InputError, match=r"^landmark 0 .* 0\.02 m from .* so the search cannot start from this"):
        drawn.movable(paper_room())


def test_a_tilted_landmark_hangs(write):
    path = write(HEADER + "0,1,1,0,0.6,0,0.8\n", "landmarks.csv")
    assert len(FileDeployment(path).draw(paper_room(), np.random.default_rng(0))) == 1


def test_ups_are_written_for_tags_and_are_upright_where_nothing_else_was_read(tmp_path):
    deployment = RandomDeployment(20).draw(paper_room(), np.random.default_rng(0))
    deployment.to_csv(tmp_path / "tags.csv", ups=True)
    assert (tmp_path / "tags.csv").read_text().startswith("id,x,y,z,nx,ny,nz,ux,uy,uz\n")
    assert_array_equal(Deployment.from_csv(tmp_path / "tags.csv").normals, deployment.normals)
    on_wall = abs(deployment.normals[:, 2]) < 0.5
    assert_array_equal(deployment.ups, np.where(on_wall[:, None], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]))
    assert Deployment.from_csv(tmp_path / "tags.csv").surveyed is None


def test_a_given_deployment_is_drawn_as_it_is_and_only_random_ones_vary():
    given_one = GivenDeployment(uniform(6))
    assert given_one.draw(paper_room(), np.random.default_rng(1)) is given_one.deployment
    sources = RandomDeployment(3), UniformDeployment(3), FileDeployment("a.csv"), given_one
    assert [source.varies for source in sources] == [True, False, False, False]
