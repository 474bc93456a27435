"""Tags as somebody surveyed them: a little behind their wall, turned in their plane, outside the room."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from support.paper import paper_camera, paper_room
from support.rooms import L_SHAPE, PILLAR, RACK, lab, mesh_room

from lmd.core.checks import InputError
from lmd.detection.frames import tagged_room
from lmd.estimation.sensors import corners_of
from lmd.evaluation.mounting import read_measured
from lmd.formats.tag_map import TagMap
from lmd.formats.tag_maps import FileDeployment
from lmd.geometry.squares import corners, upright
from lmd.objectives.coverage import Coverage
from lmd.optimisers.genetic import RandomSearch
from lmd.optimisers.ledger import Budget
from lmd.optimisers.stored import points
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.footprints import Footprints
from lmd.scene.labels import Labels
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.models.paper import Visibility
from lmd.space.changed import Inset
from lmd.space.floor_plan import FloorPlan

SEEN = Visibility(thold=0.05, nu=0.0, occlusion="none")
TAG = Tag(0.1)


@pytest.fixture(scope="module", params=["cuboid", "floor plan", "mesh"])
def room(request, tmp_path_factory):
    if request.param == "mesh":
        plan = FloorPlan(L_SHAPE, 2.5, holes=[PILLAR], obstacles=[RACK])
        return mesh_room(tmp_path_factory.mktemp("mesh") / "lab.glb", plan)
    return paper_room(spacing=1.5) if request.param == "cuboid" else lab()


def hanging(room, count=12):
    """Tags that hang flush, away from all edges."""
    return RandomDeployment(count).draw(Inset(room, 0.15), np.random.default_rng(3))


def moved(deployment, by):
    """The same tags so far before their surfaces, or behind, metres, as a file has them."""
    return Deployment(deployment.positions + by * deployment.normals, deployment.normals, labels=deployment.labels)


def saved(path, deployment, ups=None):
    deployment.to_csv(path)
    if ups is not None:
        lines = path.read_text().splitlines()
        turned = ["ux,uy,uz", *(",".join(map(repr, up)) for up in ups.tolist())]
        path.write_text("".join(f"{line},{more}\n" for line, more in zip(lines, turned, strict=True)))
    return str(path)


@pytest.mark.parametrize("by", [-0.049, -1e-4, 0.0, 1e-4, 0.049])
def test_a_tag_within_5_cm_belongs_to_its_surface_on_either_side(room, by):
    tags = hanging(room)
    there = moved(tags, by)
    assert_array_equal(room.surface_near(there.positions, there.normals), tags.surfaces)
    hung = there.with_surfaces(room)
    assert_array_equal(hung.belonging(room), tags.surfaces)
    assert_array_equal(hung.places, there.positions)
    assert_allclose(hung.positions, tags.positions if by < 0 else there.positions, atol=1e-12)


@pytest.mark.parametrize("by", [-0.06, 0.06])
def test_a_tag_farther_away_belongs_to_none(room, by):
    there = moved(hanging(room), by)
    assert (room.surface_near(there.positions, there.normals) == -1).all()


def test_in_a_corner_a_tag_belongs_to_the_surface_that_it_faces_away_from(room):
    surface = next(s for s in room.surfaces() if s.normal[2] == 0.0)
    low = surface.point(surface.extent[0] / 2.0, 0.02) - 0.03 * surface.normal  # nearer to the floor, and behind
    own = room.surface_near(low[None], surface.normal[None])[0]
    assert room.surfaces()[own].name == surface.name


@pytest.mark.parametrize("by", [-0.03, -1e-4])
def test_all_three_inputs_take_it_and_it_is_seen_as_on_its_surface(room, by, tmp_path):
    scene = Scene(room, paper_camera(), pdf.grid_with_ends(4), SEEN)
    problem = Problem(scene, Coverage(1, 0.5), RandomDeployment(12))
    tags = hanging(room)
    path = saved(tmp_path / "tags.csv", moved(tags, by))
    footprints, rng, seen = Footprints(room, Tag()), np.random.default_rng(0), problem.evaluator.counts(tags)
    assert seen.any()
    for taken in (
        FileDeployment(path).draw(room, rng),
        FileDeployment(path, free=True).draw(room, rng),
        footprints.checked_fixed(Deployment.from_csv(path), RandomDeployment(3)),
        read_measured(path, problem, tags),
    ):
        assert_array_equal(problem.evaluator.counts(taken), seen)
        taken.to_csv(tmp_path / "again.csv")
        assert (tmp_path / "again.csv").read_text() == (tmp_path / "tags.csv").read_text()


def test_outside_is_told_with_what_takes_it_there(room, tmp_path):
    low, _ = room.bounds()
    path = saved(tmp_path / "tags.csv", Deployment(np.array([low - [1.0, -1.0, -1.0]]), np.array([[1.0, 0.0, 0.0]])))
    rng, message = np.random.default_rng(0), r"landmark 0 at .* lies outside the room .*, 1 m from the nearest surface;"
    with pytest.raises(InputError, match=message):
        FileDeployment(path).draw(room, rng)
    with pytest.raises(InputError, match=rf"^fixed: {message}"):
        Footprints(room, Tag()).checked_fixed(Deployment.from_csv(path), RandomDeployment(3))
    free = FileDeployment(path, free=True)
    assert_array_equal(free.draw(room, rng).places, Deployment.from_csv(path).positions)
    assert_array_equal(
        Footprints(room, Tag()).checked_fixed(Deployment.from_csv(path), free).places, free.draw(room, rng).places
    )
    scene = Scene(room, paper_camera(), pdf.grid_with_ends(4), SEEN)
    problem = Problem(scene, Coverage(1, 0.5), free)
    assert len(read_measured(path, problem, problem.draw(rng))) == 1


def turned_by(tags, angle):
    return Rotation.from_rotvec(angle * tags.normals).apply(tags.ups)


@pytest.mark.parametrize("angle", [0.02, 1.0, np.pi])
def test_a_turn_in_the_plane_is_kept_wherever_the_tag_goes(angle, tmp_path):
    room = paper_room(spacing=1.5)
    tags = hanging(room)
    ups = turned_by(tags, angle)
    path = saved(tmp_path / "tags.csv", moved(tags, -1e-3), ups)
    fixed = Footprints(room, TAG).checked_fixed(Deployment.from_csv(path), RandomDeployment(3))
    for taken in (FileDeployment(path).draw(room, np.random.default_rng(0)), fixed):
        assert_allclose(taken.ups, ups, atol=1e-12)
        assert_allclose(TagMap(room, TAG, taken).turns.as_matrix()[:, :, 1], ups, atol=1e-12)
        assert_allclose(TagMap(room, TAG, taken).positions, moved(tags, -1e-3).positions, atol=1e-12)
        assert_allclose(tagged_room(room, taken, TAG).ups, ups, atol=1e-12)
        top = corners_of(taken, TAG)[:, :2].mean(axis=1) - taken.positions
        assert_allclose(top, 0.05 * ups, atol=1e-12)
        taken.to_csv(tmp_path / "again.csv", ups=True)
        assert_allclose(Deployment.from_csv(tmp_path / "again.csv").ups, ups, atol=1e-12)
    assert_allclose(fixed[1:3].ups, ups[1:3], atol=1e-12)
    other = tags[np.arange(2)]
    assert_allclose((fixed + other).ups, np.vstack([ups, other.ups]), atol=1e-12)


def test_fixed_tags_keep_what_was_measured_of_them_through_a_search(tmp_path):
    room = paper_room(spacing=1.5)
    ups = turned_by(tags := hanging(room, 4), 0.1)
    path = saved(tmp_path / "tags.csv", moved(tags, -0.02), ups)
    scene = Scene(room, paper_camera(), pdf.grid_with_ends(4), SEEN, TAG)
    fixed = replace(Deployment.from_csv(path), edges=np.array([0.1, np.nan, 0.1, 0.1]))
    problem = Problem(scene, Coverage(1, 0.5), RandomDeployment(3), fixed=fixed)
    assert problem.settings()["edges"] == [0.1, None, 0.1, 0.1, None, None, None]
    found = RandomSearch(seed=0).run(problem, Budget(20)).deployment
    assert_array_equal(found.places[:4], Deployment.from_csv(path).positions)
    assert_allclose(found.ups[:4], ups, atol=1e-12)
    assert_array_equal(found.places[4:], found.positions[4:])


def test_a_checkpoint_may_hold_fixed_tags_outside_the_room(tmp_path):
    room = paper_room(spacing=1.5)
    there = Deployment(np.array([[-1.0, 2.0, 1.0]]), np.array([[1.0, 0.0, 0.0]]))
    free = FileDeployment(
        saved(tmp_path / "tags.csv", replace(hanging(room), labels=Labels(np.arange(5, 17)))), free=True
    )
    problem = Problem(Scene(room, paper_camera(), pdf.grid_with_ends(4), SEEN), Coverage(1, 0.5), free, fixed=there)
    assert_array_equal(points("positions", problem.fixed.positions, problem, 1), there.positions)
    with pytest.raises(InputError):
        points("positions", there.positions - 1.0, problem, 1)


def test_a_tag_that_leans_into_its_face_touches_it():
    room, rng, footprints = lab(), np.random.default_rng(0), Footprints(lab(), Tag(0.12, quiet_zone=0.0))
    tags = hanging(room, 60)
    faces = np.array([surface.normal for surface in room.surfaces()])[tags.surfaces]
    tipped = Rotation.from_rotvec(0.02 * rng.normal(size=(60, 3))).apply(np.array(tags.normals))
    leaning = Deployment(tags.positions - 0.001 * faces, tipped)
    for hung in (
        footprints.checked_fixed(leaning, FileDeployment("of others", free=True)),
        leaning.with_surfaces(room, papers=0.12),
    ):
        papers = corners(hung.positions, hung.normals, upright(hung.normals)[1], 0.12)
        assert_allclose(((papers - tags.positions[:, None]) * faces[:, None]).sum(axis=-1).min(axis=1), 0.0, atol=1e-9)
        assert_array_equal(hung.places, leaning.positions)
