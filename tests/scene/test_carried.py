"""A rig of one camera, off the body's centre and pitched up, as that camera alone."""

from dataclasses import replace

import numpy as np
import pytest
from composing import composed
from floor_plans import lab
from numpy.testing import assert_allclose, assert_array_equal
from paper import paper_camera, paper_room

from lmd.core.checks import InputError
from lmd.scene import pdf
from lmd.scene.carried import carried
from lmd.scene.deployment_sources import UniformDeployment
from lmd.scene.rig import Mount, Rig
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator
from lmd.sight.models.paper import Visibility
from pipelines.building import build_problem

SEEN = Visibility(thold=0.05, nu=0.0, occlusion="none")


def scene_of(orientations, **mount):
    return Scene(paper_room(spacing=1.5), Rig((Mount(paper_camera(), **mount),)), orientations, SEEN)


def probabilities(scene):
    return Evaluator(scene, threads=1).probabilities(
        UniformDeployment(30).draw(scene.room, np.random.default_rng(0)), 2
    )


def test_how_it_looks_is_exact():
    """Pitched up by 0.3 on a level body is a pitch of 0.3; URDF counts that down."""
    pitched, direct = scene_of(pdf.level_flight(6), pitch=-0.3), pdf.level_flight(6, pitch=0.3)
    alone = carried(pitched)
    assert_allclose(alone.pdf.pitch, direct.pitch)
    assert_allclose(np.cos(alone.pdf.yaw - direct.yaw), 1.0)
    assert_allclose(alone.pdf.roll, 0.0, atol=1e-12)
    assert_array_equal(probabilities(alone), probabilities(replace(alone, pdf=direct)))
    drawn, of_body = (which.draw(5, np.random.default_rng(0)) for which in (alone.pdf, pitched.pdf))
    assert_allclose(drawn[1], 0.3)
    assert_allclose(np.cos(drawn[0] - of_body[0]), 1.0)
    assert_allclose(alone.pdf.stratified(2, np.random.default_rng(0)).pitch, 0.3)
    assert len(alone.pdf.finer().yaw) == 24


@pytest.mark.parametrize("orientations", [pdf.level_flight(6), pdf.grid_of_cells(4)])
def test_turned_in_place_it_covers_what_the_rig_covers(orientations):
    scene = scene_of(orientations, yaw=0.2, pitch=-0.4, roll=0.1)
    assert_allclose(probabilities(carried(scene)), probabilities(scene), atol=1e-9)


def test_above_a_level_body_it_covers_what_the_rig_covers():
    scene = scene_of(pdf.level_flight(6), translation=(0.0, 0.0, 0.25), pitch=-0.4)
    alone = carried(scene)
    assert_allclose(alone.room.grid(), scene.room.grid() + np.array([0.0, 0.0, 0.25]))
    assert_allclose(probabilities(alone), probabilities(scene), atol=1e-9)
    low = alone.room.sample(200, np.random.default_rng(0))[:, 2].min() - scene.room.reachable_low[2]
    assert 0.25 <= low < 0.4
    assert_allclose(alone.room.relevance.weights(alone.room.grid()), scene.room.relevance.weights(scene.room.grid()))


@pytest.mark.parametrize("room", [paper_room(spacing=0.7), lab(spacing=0.25, height=(0.5, 1.0))])
def test_off_the_centre_it_covers_what_the_rig_covers(room):
    """In the mean over random positions, which the two draw differently; without the turn that is 3 points off."""
    scene = replace(scene_of(pdf.level_flight(6), translation=(0.15, -0.05, 0.25), pitch=-0.4), room=room)
    alone = carried(scene)
    deployment = UniformDeployment(30).draw(room, np.random.default_rng(0))
    by_rig, by_camera = (
        Evaluator(which, which.room.sample(2000, np.random.default_rng(0)), 1).probabilities(deployment, 2).mean()
        for which in (scene, alone)
    )
    assert by_camera == pytest.approx(by_rig, abs=0.01)
    for positions in (alone.room.grid(), alone.room.jittered_grid(2, np.random.default_rng(0))):
        assert_allclose(alone.probability(positions).sum(axis=1), 1.0)
    assert len(alone.room.finer().grid()) > len(alone.room.grid()) == len(room.grid())
    assert_allclose(alone.room.relevance.weights(alone.room.grid()), 1.0)


def test_other_cameras_stay_as_they_are():
    scene = scene_of(pdf.level_flight(6))
    for other in (replace(scene, camera=paper_camera()), replace(scene, camera=Rig(2 * scene.camera.mounts))):
        assert carried(other) is other


def test_a_camera_outside_the_room_is_refused():
    with pytest.raises(InputError, match=r"^rig has a camera at .*, outside the room"):
        carried(scene_of(pdf.level_flight(6), translation=(0.0, 0.0, 3.0)))


@pytest.mark.parametrize("orientations", [[], ["pdf=yaw"]])
def test_the_lab_takes_a_rig_of_one_camera(orientations):
    mount = "camera.rig=[{translation: [0.1,0,0.3], pitch: -0.3}]"
    cfg = composed("optimise", "experiment=lab", "room.spacing=1", "pdf.divisions=4", *orientations, mount)
    problem = build_problem(cfg)
    found = problem.metrics(problem.draw(np.random.default_rng(0)))
    assert 0.0 < found["localised_share"] < 1.0
    cfg.camera.rig = [{"translation": [0.0, 0.0, 2.0]}]
    with pytest.raises(InputError, match=r"^camera\.rig has a camera at"):
        build_problem(cfg)
