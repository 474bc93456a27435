"""People in rendered images stand where they hide tags."""

import numpy as np

from lmd.geometry.camera import Camera
from lmd.geometry.projection import project
from lmd.geometry.se3 import camera_pose
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom, faces_of
from lmd.scene.tag import Tag
from lmd.space.crowd import Crowd, CrowdStates

CAMERA = Camera(4.0, 0.006, 0.006, (320.0, 240.0), 640, 480, 0.0)
PERSON = np.array([[3.0, 0.0, 0.25, 0.0, 1.75]])


def test_faces_enclose_the_cylinder():
    faces = faces_of(PERSON)
    points = np.concatenate([face.point(*face.parts.reshape(-1, 2).T) for face in faces])
    away = np.hypot(points[:, 0] - 3.0, points[:, 1])
    sides = away[away > 0.2]
    assert np.abs(sides - 0.25).max() < 1.3e-3
    assert (points[:, 2].min(), points[:, 2].max()) == (0.0, 1.75)
    for face in faces:
        middle = face.point(face.extent[0] / 2.0, face.extent[1] / 2.0)
        assert (middle - [3.0, 0.0, 0.9]) @ face.normal > 0.0
        np.testing.assert_allclose(np.cross(face.u, face.v), face.normal, atol=1e-12)


def test_a_tag_is_painted_where_no_person_stands_before_it():
    # Tags on a wall 5 m away, in a row at eye level: pixels at their centres are of a tag or of the person.
    y = np.linspace(-1.2, 1.2, 25)
    centres = np.column_stack([np.full(25, 5.0), y, np.full(25, 1.0)])
    towards, up = np.tile([-1.0, 0.0, 0.0], (25, 1)), np.tile([0.0, 0.0, 1.0], (25, 1))
    plain = Imaging(texture=0.0, noise=0.0)
    room = TaggedRoom(Tag(0.05, "36h11"), np.arange(25), centres, towards, up)
    pose = camera_pose(np.array([0.0, 0.0, 1.2]), np.pi / 2.0, 0.0, 0.0)
    images = [
        Renderer(CAMERA, each, plain).frame(pose, np.random.default_rng(0)) for each in (room, room.among(PERSON))
    ]
    assert (images[0] != images[1]).any()
    clear = CrowdStates(Crowd(1), PERSON[None]).clear(pose[:3, 3], centres)
    assert 3 < (~clear).sum() < 20
    at = project(CAMERA, pose, centres).astype(int)
    around = [[image[v - 4 : v + 5, u - 4 : u + 5] for u, v in at] for image in images]
    painted = np.array([np.array_equal(before, after) for before, after in zip(*around, strict=True)])
    sure = np.abs(np.abs(y) - 0.25 * 5.0 / 3.0) > 0.06
    np.testing.assert_array_equal(painted[sure], clear[sure])
