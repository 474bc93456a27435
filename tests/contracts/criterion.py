"""What a criterion, a model of sight, promises: every fast path decides as its reference does."""

from dataclasses import replace

import numpy as np
from support.rooms import lab

from contracts.field import check_field
from lmd.objectives.coverage import Coverage
from lmd.scene import pdf
from lmd.scene.criteria import from_around, horizon_of
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.rig import Mount, Rig
from lmd.scene.scene import Scene
from lmd.sight import reference
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import PROBABILITY_ONE
from lmd.sight.poses import covered_amounts, gains, wall_cells
from lmd.sight.views import visible
from lmd.space.cuboid import Cuboid


def check_criterion(criteria, camera, seed=0):
    """Check a criterion, compiled or not, in an empty room, and with two cameras on one body among obstacles.

    Args:
        criteria: a `lmd.scene.criteria.Criteria`.
        camera: sees some landmarks of a room of 4 x 3 x 2.5 m from some of its positions, and not all.
        seed: of landmarks, moves and prices.
    """
    rng = np.random.default_rng(seed)
    check_alone(criteria, camera, rng)
    other = replace(camera, focal_length=1.2 * camera.focal_length)
    check_seen(lab(spacing=1.0), Rig((Mount(camera, (0.1, 0.0, 0.0)), Mount(other, yaw=2.0))), criteria, rng)


def check_alone(criteria, camera, rng):
    """Check a criterion in an empty room."""
    check_members(criteria, camera, rng)
    check_seen(Cuboid((4.0, 3.0, 2.5), (3.2, 2.2, 1.5), 0.8), camera, criteria, rng)


def check_seen(room, camera, criteria, rng):
    """Check what is seen of landmarks in a room, as they are and as they move, and the bounds of it."""
    orientations = pdf.grid_with_ends(4, [(-0.4, 0.5), (0.3, 0.5)] if criteria.needs_roll else 0.0)
    scene = Scene(room, camera, orientations, criteria)
    deployment, targets = tilted(RandomDeployment(24).draw(room, rng), rng), RandomDeployment(8).draw(room, rng)
    seen = reference.counts(scene, deployment)
    assert 0 < seen.max() < len(deployment), "the camera sees no landmark, or all of them at once"
    check_every_path(scene, deployment, targets, 2, rng)
    assert check_gains(scene, deployment[:4], rng), "none of four landmarks is covered on its own"
    if scene.is_compiled:
        check_slack(scene, 1.0, rng)
        check_shrunk(scene, deployment)


def check_members(criteria, camera, rng):
    """The members of a criterion are of their kinds, and so are those of what it compiles to, if it does."""
    positions = rng.uniform(-2.0, 2.0, (30, 3))
    normals = -positions / np.linalg.norm(positions, axis=1, keepdims=True)
    axes = pdf.grid_of_cells(6, 0.3).by_axis_and_roll.axes
    covered = criteria.covered(camera, np.zeros(3), axes, positions, normals)
    assert (covered.shape, covered.dtype) == ((len(axes), 30), np.dtype(bool))
    assert isinstance(criteria.needs_roll, bool)
    assert criteria.spacing >= 0.0
    if not criteria.needs_roll:
        rolled = np.hstack([axes[:, :3], np.cross(axes[:, :3], axes[:, 3:])])
        np.testing.assert_array_equal(criteria.covered(camera, np.zeros(3), rolled, positions, normals), covered)
    if criteria.sight(camera) is not None:
        check_sight(criteria, camera, (axes, positions, normals), covered, rng)


def check_sight(criteria, camera, views, covered, rng):
    """What a criterion compiles to agrees with what it covers, `(A, 30)`, of axes, positions and normals, `views`."""
    sight, (axes, positions, normals) = criteria.sight(camera), views
    assert isinstance(sight, tuple), "what kernels take is a named tuple"
    assert sight.inset >= 0.0
    assert horizon_of(sight) > 0.0
    among = sight.among(np.full(3, -0.1), np.full(3, 0.1), positions.T[None], normals.T[None])
    for other in (sight.unhidden(), sight.shrunk(0.5), among):
        assert type(other) is type(sight), "a variant is of another class, for which nothing is compiled"
    assert sight.unhidden().reach < 0.0
    assert sight.shrunk(1.0) == sight
    cosines = axes[:, :3] @ (-normals.T)
    assert (cosines[covered] >= sight.outer_cosine).all(), "covered beyond the outer cone"
    radius = 0.3
    nearby = radius * rng.uniform(-1.0, 1.0, 3) / np.sqrt(3.0)
    bounds = [from_around(sight, *map(tuple, pair), radius) for pair in zip(positions, normals, strict=True)]
    reached, most = (np.array([each[i] for each in bounds]) for i in (0, 1))
    moved = criteria.covered(camera, nearby, axes, positions, normals)
    assert not moved[:, ~reached].any(), "covered from a place around a point from which it is not reached"
    depths = axes[:, :3] @ (positions - nearby).T
    assert (depths <= most + 1e-9)[moved].all(), "covered beyond the greatest depth from around a point"
    far = np.linalg.norm(positions, axis=1) > horizon_of(sight)
    assert not covered[:, far].any(), "covered beyond the horizon"


def check_every_path(scene, deployment, targets, n, rng):
    """Check single views, moves to `targets`, and all counts after them, against the reference."""
    check_views(scene, deployment)
    check_counts(scene, check_field(Coverage(n, 0.5), scene, deployment, targets, rng), n)


def check_views(scene, deployment, by_reference=False):
    """Check single views against the reference."""
    axes, evaluator = scene.orientations.axes, Evaluator(scene, threads=1, by_reference=by_reference)
    for position in scene.room.grid()[:2]:
        seen = visible(evaluator, deployment, np.tile(position, (len(axes), 1)), axes)
        np.testing.assert_array_equal(seen, reference.coverage_caps(scene, deployment, position, axes))


def check_counts(scene, deployment, n, threads=1):
    """Check counts, and P_n to the bit in whole units, against the reference."""
    evaluator, counts = Evaluator(scene, threads=threads), reference.counts(scene, deployment)
    np.testing.assert_array_equal(evaluator.counts(deployment), counts)
    distinct = counts[:, np.unique(evaluator.axis_of, return_index=True)[1]]
    units = np.where(distinct >= n, evaluator.weights[:, : distinct.shape[1]], 0).sum(axis=1)
    found = evaluator.units(deployment.positions[None], deployment.normals[None], n)[0]
    np.testing.assert_array_equal(found, units)
    formula = reference.coverage_probability(counts, scene.pdf, n, scene.room.grid())
    np.testing.assert_allclose(found / PROBABILITY_ONE, formula, rtol=0.0, atol=1e-12)


def check_gains(scene, poses, rng, by_reference=False):
    """Check what poses gain, and cover, each on its own, against the reference; returns whether any covers anything."""
    evaluator = Evaluator(scene, threads=2, by_reference=by_reference)
    cover = cover_matrix(scene, poses)
    prices, amounts = np.zeros((len(evaluator.positions), evaluator.axes.shape[1])), rng.random(len(poses))
    size = len(scene.orientations.axes)
    # Powers of two add up exactly, so that a single wrong decision shows.
    prices[:, :size] = 2.0 ** rng.integers(0, 20, (len(prices), size))
    np.testing.assert_array_equal(gains(evaluator, poses, prices), cover @ prices[:, :size].ravel())
    covered = covered_amounts(evaluator, poses, amounts)
    np.testing.assert_allclose(covered[:, :size].ravel(), amounts @ cover, rtol=1e-12, atol=1e-12)
    assert not covered[:, size:].any()
    return cover.any()


def check_slack(scene, spacing, rng):
    """Check the bounds of `lmd.evaluation.bounds`: a cell of a wall gains as much as any landmark in it, or more.

    A model that ignores `slack` fails: the centre of a cell covers less than other places in it.
    """
    evaluator, cells = Evaluator(scene, threads=1), wall_cells(scene.room, spacing)
    prices = rng.random((len(evaluator.positions), evaluator.axes.shape[1]))
    cells = cells.picked(rng.integers(len(cells.poses), size=20))
    most = gains(evaluator, cells.poses, prices, cells.radius)
    for corner in (False, True):
        a, b = rng.uniform(-1.0, 1.0, (2, 20, 1))
        a, b = (np.sign(a), np.sign(b)) if corner else (a, b)
        inside = Deployment(cells.poses.positions + a * cells.half_u + b * cells.half_v, cells.poses.normals)
        assert (gains(evaluator, inside, prices) <= most * (1.0 + 1e-12)).all(), "a landmark gains more than its cell"


def check_shrunk(scene, deployment):
    """Check that landmarks with smaller bodies are seen as often or more, and with their own as they are."""
    field = Coverage(1, 0.5).field(Evaluator(scene, threads=1))
    whole, same, half, small = (
        each.state(deployment).units for each in (field, field.shrunk(1.0), field.shrunk(0.5), field.shrunk(0.1))
    )
    np.testing.assert_array_equal(same, whole)
    assert (half >= whole).all(), "a smaller body hides more"
    assert (small >= half).all(), "a smaller body hides more"


def cover_matrix(scene, poses):
    """Which pose covers which position and distinct orientation, `(N, P * D)`, by the reference, each on its own."""
    first = np.unique(scene.orientations.index_of, return_index=True)[1]
    alone = (reference.counts(scene, Deployment(poses.positions[[j]], poses.normals[[j]])) for j in range(len(poses)))
    return np.stack([counts[:, first].ravel() for counts in alone])


def tilted(deployment, rng, scale=0.3):
    """The landmarks, turned a little at random."""
    normals = deployment.normals + rng.normal(scale=scale, size=deployment.normals.shape)
    return Deployment(deployment.positions, normals / np.linalg.norm(normals, axis=1, keepdims=True))
