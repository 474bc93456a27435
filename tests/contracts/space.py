"""What a space, a room, promises."""

import numpy as np
from support.paper import paper_camera

from contracts.criterion import check_counts, check_every_path
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.scene import Scene
from lmd.sight.models.paper import Visibility

INWARDS = 0.5  # metres in front of a surface, where no landmark hangs


def check_space(room, seed=0, *, moves=True):
    """Check surfaces, positions, and that lines of sight are blocked as the reference says.

    Args:
        room: a `lmd.space.space.Space`, some metres wide, with a coarse grid.
        seed: of landmarks and positions.
        moves: check what is seen as landmarks move too, for which kernels are compiled for each kind of blockers.
    """
    rng = np.random.default_rng(seed)
    check_surfaces(room, rng)
    check_positions(room)
    check_lines(room, rng)
    check_drawing(room)
    scene = Scene(room, paper_camera(), pdf.grid_with_ends(6), Visibility(thold=0.1, occlusion="line_of_sight"))
    deployment, targets = (RandomDeployment(count).draw(room, rng) for count in (20, 6))
    if moves:
        check_every_path(scene, deployment, targets, 2, rng)
    else:
        check_counts(scene, deployment, 2)


def check_surfaces(room, rng):
    """Surfaces have right angles and face the room; landmarks on them know which they hang on."""
    low, high = room.bounds()
    for surface in room.surfaces():
        axes = np.stack([surface.u, surface.v, surface.normal])
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-9)
        assert surface.area > 0.0
    hung = RandomDeployment(200).draw(room, rng)
    assert room.contains(hung.positions).all()
    assert ((hung.positions >= low - 1e-6) & (hung.positions <= high + 1e-6)).all()
    np.testing.assert_array_equal(room.surfaces_of(hung.positions, hung.normals), hung.surfaces)
    np.testing.assert_array_equal(room.surface_near(hung.positions, hung.normals), hung.surfaces)
    np.testing.assert_array_equal(
        hung.normals, np.array([surface.normal for surface in room.surfaces()])[hung.surfaces]
    )
    away = hung.positions + INWARDS * hung.normals
    on_none = np.min([surface.distance(away) for surface in room.surfaces()], axis=0) > 1e-3
    assert on_none.any()
    assert (room.surfaces_of(away, hung.normals)[on_none] == -1).all(), "what hangs on nothing has a surface"


def check_positions(room):
    """Positions lie inside, in as many cells as there are; draws are those of their seed and agree on the mean."""
    grid = room.grid()
    assert grid.shape == (len(np.unique(grid.round(9), axis=0)), 3)
    assert room.contains(grid).all()
    assert not room.contains(np.stack(room.bounds()) + np.array([[-1.0], [1.0]])).any()
    weights = room.relevance.weights(grid)
    assert weights.shape == (len(grid),)
    assert weights.min() >= 0.0
    assert len(room.finer().grid()) > len(grid)
    assert len(room.finer().surfaces()) == len(room.surfaces())

    draws = {name: lambda seed, draw=draw: draw(np.random.default_rng(seed)) for name, draw in (
        ("jittered_grid", lambda rng: room.jittered_grid(3, rng)),
        ("sample", lambda rng: room.sample(2000, rng)),
        ("sample_evenly", lambda rng: room.sample_evenly(2000, rng)),
    )}  # fmt: skip
    for name, draw in draws.items():
        points = draw(0)
        assert points.shape == (3 * len(grid) if name == "jittered_grid" else 2000, 3), name
        assert room.contains(points).all(), name
        np.testing.assert_array_equal(draw(0), points, name)
        assert not np.array_equal(draw(1), points), name
    one, other = draws["sample"](0), draws["sample_evenly"](0)
    error = one.std(axis=0) / np.sqrt(len(one))
    assert (np.abs(one.mean(axis=0) - other.mean(axis=0)) <= 5.0 * error).all(), "two ways to draw disagree"


def check_lines(room, rng):
    """A line is as free one way as the other; a room without blockers blocks none; short flights pass."""
    points = room.sample(200, rng)
    starts, ends = points[:100], points[100:]
    for asked in (room.clear, room.passable):
        free = asked(starts, ends)
        assert (free.shape, free.dtype) == ((100,), np.dtype(bool))
        np.testing.assert_array_equal(free, asked(ends, starts))
        assert asked(starts, starts).all(), "a point is cut off from itself"
    assert room.blockers() is not None or room.clear(starts, ends).all()


def check_drawing(room):
    """What is drawn is there, and inside the bounds."""
    low, high = room.bounds()
    outline = room.outline()
    assert {"room", "reachable area"} <= set(outline)
    for name, edges in outline.items():
        assert edges.shape[1:] == (2, 3), name
        assert ((edges >= low - 1e-6) & (edges <= high + 1e-6)).all(), name
    assert len(room.faces()) > 0
    assert all(hasattr(fixture, "name") for fixture in room.fixtures())
    assert isinstance(room.describe(), str)
