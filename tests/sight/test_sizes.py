"""Tags of several sizes: every fast path against the reference, and that against scenes with tags of one size."""

from dataclasses import replace

import numpy as np
import pytest
from contracts.criterion import check_counts, check_every_path, check_shrunk, tilted
from contracts.field import check_field
from support.rooms import lab
from test_fiducial import LENSES, fiducial_scene

from lmd.objectives.localisation import Localisation
from lmd.objectives.localisation import reference as localisation
from lmd.objectives.localisation.evaluation import localised_views
from lmd.scene import pdf
from lmd.scene.criteria import sized
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.rig import Mount, Rig
from lmd.sight import reference
from lmd.sight.evaluator import Evaluator
from lmd.sight.obstacles import half_edge

pytestmark = [pytest.mark.slow, pytest.mark.long]  # kernels of two more models of sight

# Of tags of several sizes before a lens and before a rig, each of which takes some 4 s to compile.
other_sights = pytest.mark.thorough("lmd/objectives/localisation", "lmd/sight")
EDGES = (0.05, 0.1, 0.3)
COUNT = 24


def several(scene, count=COUNT):
    return scene.sized(np.resize(EDGES, count))


def lab_scene(lens="none"):
    orientations = pdf.grid_with_ends(6, [(-0.4, 0.5), (0.3, 0.5)])
    return fiducial_scene(lab(spacing=1.0), orientations, lens=lens)


def drawn(scene, seed=0, count=COUNT):
    rng = np.random.default_rng(seed)
    return tilted(RandomDeployment(count).draw(scene.room, rng), rng), RandomDeployment(8).draw(scene.room, rng), rng


@pytest.mark.parametrize("lens", LENSES)
def test_the_sight_of_a_tag_has_the_numbers_of_a_scene_with_tags_of_its_size(lens):
    plain = lab_scene(lens)
    scene = several(plain)
    assert np.shape(half_edge(scene.sight)) == (COUNT,)
    for k, edge in enumerate(scene.edges):
        mine, alone = sized(scene.sight, k), plain.sized(np.array([edge])).sight
        parts = ([getattr(each, "flat", each), *getattr(each, "pinholes", ())] for each in (mine, alone))
        for one, other in zip(*parts, strict=True):
            assert one._replace(inset=0.0, reach=0.0) == other._replace(inset=0.0, reach=0.0)


def test_every_path_is_exact_among_obstacles():
    scene = several(lab_scene())
    deployment, targets, rng = drawn(scene)
    check_every_path(scene, deployment, targets, 2, rng)
    check_shrunk(scene, deployment)


@other_sights
def test_behind_a_lens_that_distorts_an_evaluation_is_exact():
    scene = several(lab_scene("barrel"))  # of its sizes, moves ask the same functions
    check_counts(scene, drawn(scene)[0], 2)


@other_sights
def test_what_a_rig_counts_is_exact_among_obstacles():
    plain = lab_scene()
    rig = Rig((Mount(plain.camera, (0.1, 0.0, 0.0)), Mount(plain.camera, yaw=2.0)))
    scene = several(replace(plain, camera=rig))  # of its sizes, moves ask the same functions
    check_counts(scene, drawn(scene)[0], 2)


def test_views_are_localised_as_the_reference_says_and_by_moves():
    scene = several(lab_scene())
    deployment, targets, rng = drawn(scene)
    objective = Localisation(1, tolerance=0.03)  # the two poses of a tag must be told apart
    check_field(objective, scene, deployment, targets, rng)
    evaluator, axes = Evaluator(scene, threads=1), scene.orientations.axes
    views = localised_views(
        evaluator, deployment.positions[None], deployment.normals[None], 1, objective.precision(scene)
    )
    for p in range(0, len(evaluator.positions), 10):
        good = localisation.localised(
            scene, deployment, objective.n, objective.precision(scene), evaluator.positions[p], axes
        )
        assert views.localised[0, p] == evaluator.weights[0, : len(axes)][good].sum()
    assert 0 < views.localised.sum() < views.covered.sum()


@other_sights
def test_a_rig_of_one_camera_localises_as_that_camera():
    plain = lab_scene()
    one, objective = several(plain), Localisation(1, tolerance=0.03)  # two poses of a tag, as above
    rig = several(replace(plain, camera=Rig((Mount(plain.camera),))))
    deployment, _, _ = drawn(one)
    alone, both = (
        objective.values(Evaluator(each, threads=1), deployment.positions[None], deployment.normals[None])
        for each in (one, rig)
    )
    np.testing.assert_allclose(both, alone, atol=2e-3)  # views at the tolerance may fall to either side
    assert alone.max() > 0.0


def test_each_tag_alone_is_seen_as_in_a_scene_with_tags_of_its_size():
    plain = lab_scene()
    deployment, _, _ = drawn(plain)
    scene, axes, some = several(plain), plain.orientations.axes, 0
    for position in plain.room.grid()[:20]:
        covered = reference.coverage_caps(scene, deployment, position, axes)
        for k in range(COUNT):
            alone = plain.sized(scene.edges[k : k + 1])
            covered_now = reference.coverage_caps(alone, deployment[k : k + 1], position, axes)[:, 0]
            assert (covered[:, k] <= covered_now).all()
            some += (covered[:, k] & covered_now).sum()
    assert some > 1000
