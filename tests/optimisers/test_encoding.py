import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.paper import experiment_room, paper_room
from support.strategies import flush_deployments, seeds

from lmd.optimisers.encoding import make_encoding
from lmd.scene.deployment import Deployment

ROOMS = st.sampled_from([paper_room(), experiment_room(), paper_room(walls=("ceiling", "y_min"))])
ENCODINGS = [("wall", True), ("wall", False), ("paper", True), ("paper", False)]


@st.composite
def tilted_deployments(draw, room):
    flush = draw(flush_deployments(room))
    rng = np.random.default_rng(draw(seeds))
    normals = flush.normals + 0.9 * rng.uniform(-1.0, 1.0, flush.normals.shape) / np.sqrt(3.0)
    return Deployment(flush.positions, normals / np.linalg.norm(normals, axis=1, keepdims=True))


@pytest.mark.parametrize(("kind", "flush"), ENCODINGS)
@given(data=st.data())
def test_decoding_what_was_encoded_gives_the_same_landmarks(kind, flush, data):
    room = data.draw(ROOMS)
    deployment = data.draw(flush_deployments(room) if flush else tilted_deployments(room))
    encoding = make_encoding(kind, room, flush)
    positions, normals, _ = encoding.decode(encoding.encode(deployment)[None])
    np.testing.assert_allclose(positions[0], deployment.positions, atol=1e-5)
    np.testing.assert_allclose(normals[0], deployment.normals, atol=1e-7)


@pytest.mark.parametrize(("kind", "flush"), ENCODINGS)
@given(room=ROOMS, seed=seeds)
def test_any_genes_decode_to_landmarks_on_allowed_walls(kind, flush, room, seed):
    encoding = make_encoding(kind, room, flush)
    genes = np.random.default_rng(seed).random((3, 5 * encoding.genes_per_landmark)).round(1)  # 0 and 1 occur
    positions, normals, surfaces = encoding.decode(genes)
    assert positions.shape == normals.shape == (3, 5, 3)
    on_wall = [np.abs((positions - wall.origin) @ wall.normal) < 1e-12 for wall in room.surfaces()]
    assert np.any(on_wall, axis=0).all()
    assert np.take_along_axis(np.array(on_wall), surfaces[None], axis=0).all()
    assert room.contains(positions).all()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1.0)


@pytest.mark.parametrize("kind", ["wall", "paper"])
def test_a_landmark_in_a_corner_keeps_its_wall(kind):
    room = paper_room()
    encoding = make_encoding(kind, room, flush=True)
    corners = np.array([wall.point(a, b) for wall in room.surfaces() for a in (0, wall.extent[0])
                        for b in (0, wall.extent[1])])  # fmt: skip
    normals = np.repeat([wall.normal for wall in room.surfaces()], 4, axis=0)
    positions, decoded, _ = encoding.decode(encoding.encode(Deployment(corners, normals))[None])
    np.testing.assert_allclose(positions[0], corners, atol=1e-5)
    np.testing.assert_array_equal(decoded[0], normals)


def test_the_paper_encoding_projects_to_the_nearest_wall():
    encoding = make_encoding("paper", paper_room(), flush=True)
    genes = np.array([[0.1, 0.5, 0.5, 0.3, 0.3, 0.5, 0.5, 0.9, 0.3, 0.3]])
    positions, normals, _ = encoding.decode(genes)
    np.testing.assert_allclose(positions[0], [[0.0, 2.5, 3.0], [3.75, 2.5, 6.0]])
    np.testing.assert_array_equal(normals[0], [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def test_uniform_wall_genes_are_uniform_over_the_area():
    room = paper_room()
    genes = np.random.default_rng(0).random((1, 2 * 60_000))
    _, normals, _ = make_encoding("wall", room, flush=True).decode(genes)
    area = np.array([wall.area for wall in room.surfaces()])
    share = [(normals[0] == wall.normal).all(axis=1).mean() for wall in room.surfaces()]
    np.testing.assert_allclose(share, area / area.sum(), atol=0.01)
