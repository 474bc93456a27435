"""Coverage lost to each criterion, against the coverage without that criterion."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from support.paper import paper_camera, paper_room, paper_scene

from lmd.evaluation.verdicts import CAUSES_STREAM, VIEWS, causes
from lmd.geometry.se3 import axis_and_right, camera_pose
from lmd.scene import pdf
from lmd.scene.deployment_sources import UniformDeployment
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.models.fiducial import Fiducial
from lmd.sight.models.paper import Visibility

UNIFORM = UniformDeployment(30).draw(paper_room(), np.random.default_rng(0))


def looks(scene, deployment, seed=0, positions=256):
    """The share of covered looks by the model's own `covered`, from the same poses."""
    rng = np.random.default_rng([seed, CAUSES_STREAM])
    places = scene.room.sample(positions, rng)
    axes = axis_and_right(camera_pose(np.zeros(3), *scene.pdf.draw(VIEWS * positions, rng)))
    landmarks = deployment.positions, deployment.normals
    seen = [
        scene.visibility.covered(scene.camera, place, views, *landmarks)
        for place, views in zip(places, np.split(axes, positions), strict=True)
    ]
    return float(np.mean(seen))


@pytest.mark.parametrize("thold", [0.28, 1.2])
def test_dropping_a_criterion_covers_what_it_is_said_to(thold):
    scene = paper_scene(thold=thold)
    found = causes(scene, UNIFORM, 0)
    assert found.sightings == 256 * VIEWS * 30
    assert found.covered == pytest.approx(looks(scene, UNIFORM), abs=0.0)
    endless = Visibility(thold=1e-9)
    alone = Visibility(thold=thold, occlusion="none")
    for name, visibility in (("resolution", endless), ("hiding", alone)):
        dropped = looks(replace(scene, visibility=visibility), UNIFORM)
        assert found.without[name] == pytest.approx(dropped, abs=0.0)
    sharp = replace(scene, camera=paper_camera(aperture=1e-3))  # its depth of field has no end
    assert found.without["focus"] == pytest.approx(looks(sharp, UNIFORM), abs=0.0)


def test_where_the_resolution_asks_for_less_depth_than_the_focus_allows_it_is_to_blame():
    found = causes(paper_scene(thold=1.2), UNIFORM, 0)
    assert found.covered == 0.0
    assert found.without["resolution"] > 0.05
    assert found.met["facing"] == 1.0  # in front of a wall, whose landmarks are flush
    text = found.to_text().splitlines()
    assert text[0].startswith("0.00% of 122,880 sightings of single landmarks")
    assert text[2].startswith("resolution ")
    assert text[2].endswith("depth up to 0.72 m (thold = 1.2 pixel/mm)")
    assert any(line.startswith("focus ") and line.endswith("depth from 0.975 to 10 m") for line in text)
    assert any("within 34.8 degrees of the optical axis" in line for line in text)


def test_the_figures_have_names():
    found = causes(paper_scene(), UNIFORM, 3)
    assert set(found.metrics()) == {"covered"} | {
        key
        for name in ("resolution", "field_of_view", "focus", "facing", "hiding")
        for key in (f"{name}_met", f"covered_without_{name}")
    }
    assert all(found.covered <= found.without[name] <= 1.0 for name in found.without)
    assert found == causes(paper_scene(), UNIFORM, 3)


def test_a_detector_is_explained_too():
    camera = paper_camera()
    scene = Scene(paper_room(), camera, pdf.grid_with_ends(), Fiducial(Tag(0.1), limits={"pitch": 30.0}))
    found = causes(scene, UNIFORM, 0)
    assert found.covered == looks(scene, UNIFORM)
    assert max(found.without, key=found.without.get) == "resolution"
    assert found.limits["resolution"].startswith("30 pixels a module")
    width = 2.0 * math.degrees(math.atan(800 * 0.0058 / 5.0))
    assert f"in the image of {width:.3g} x " in found.limits["field_of_view"]
    assert set(found.limits) == set(found.without)


@dataclass(frozen=True)
class Terse(Visibility):
    """Says which criteria are met, and not what they come to."""

    limits_for = None


def test_a_model_that_cannot_tell_says_nothing():
    assert causes(replace(paper_scene(), visibility=object()), UNIFORM, 0) is None
    found = causes(replace(paper_scene(), visibility=Terse(0.28)), UNIFORM, 0)
    assert found.limits == {}
    assert "resolution" in found.to_text()
