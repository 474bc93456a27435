from dataclasses import replace

import numpy as np
import pytest

from lmd.core.checks import InputError
from lmd.detection.detectors import AprilTagDetector
from lmd.detection.frames import tagged_room
from lmd.geometry.camera import Camera
from lmd.geometry.projection import to_camera
from lmd.geometry.se3 import camera_pose
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom
from lmd.scene.deployment_sources import UniformDeployment
from lmd.scene.tag import Tag
from lmd.space.cuboid import Cuboid

# 500 pixels a metre at a depth of 1 m.
CAMERA = Camera(5.0, 0.01, 0.01, (160.0, 120.0), 320.0, 240.0, 1.0, 1000.0)
BARREL = (-0.25, 0.08, 0.001, -0.002, 0.01)
BENT = replace(CAMERA, distortion=BARREL)
SHARP = Imaging(psf_sigma=0.0, defocus=False, noise=0.0)
ROOM = Cuboid((4.0, 4.0, 3.0), (2.0, 2.0, 1.0), 0.5)
ORIGIN = camera_pose([0.0, 0.0, 0.0], 0.0, 0.0)  # looks along y, up is z


def facing(centre=(0.0, 1.0, 0.0), edge=0.16, turn=0.0, surfaces=(), family="36h11", number=7, normal=(0.0, -1.0, 0.0)):
    """One tag that looks back at a camera at the origin, turned counter-clockwise as seen from the front."""
    normal = np.array(normal)
    up = np.array([0.0, 0.0, 1.0])
    left = -np.cross(up, normal)
    up = np.cos(turn) * up + np.sin(turn) * left
    return TaggedRoom(Tag(edge, family), np.array([number]), np.array([centre]), normal[None], up[None], surfaces)


def frame(camera=CAMERA, room=None, imaging=SHARP, pose=ORIGIN, seed=0, motion=None):
    return Renderer(camera, room or facing(), imaging).frame(pose, np.random.default_rng(seed), motion)


def test_a_sharp_tag_is_its_picture():
    # 0.16 m at 1 m are 80 pixels, 10 a module, from 120 to 200 across and from 80 to 160 down.
    image = frame()
    picture = np.kron(Tag(0.16).picture(7), np.ones((10, 10), dtype=bool))
    margin = 3  # where one module ends and the next begins, sampling makes greys
    inside = np.zeros((10, 10), dtype=bool)
    inside[margin:-margin, margin:-margin] = True
    sure = np.tile(inside, (8, 8))
    expected = np.where(picture, SHARP.white, SHARP.black)
    np.testing.assert_array_equal(image[80:160, 120:200][sure], expected[sure])
    assert set(np.unique(image[:60])) == {int(SHARP.wall)}
    # The paper has a margin of one module.
    quiet = np.flatnonzero(image[:, 115] > 185)
    assert (quiet[0], quiet[-1], len(quiet)) == (70, 169, 100)


def test_up_is_up_and_turns_are_counter_clockwise():
    upright = frame()[80:160, 120:200]
    for quarters in range(4):
        turned = frame(room=facing(turn=quarters * np.pi / 2.0))[80:160, 120:200]
        np.testing.assert_allclose(turned.astype(int), np.rot90(upright, quarters).astype(int), atol=2)


def test_the_seed_decides_the_noise():
    noisy = Imaging(noise=3.0)
    first, again, other = (frame(imaging=noisy, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.5
    assert first[:50].std() == pytest.approx(3.0, rel=0.03)


def test_exposure_and_gamma():
    assert frame(imaging=replace(SHARP, exposure=0.5))[0, 0] == 75
    assert frame(imaging=replace(SHARP, gamma=2.0))[0, 0] == round(255.0 * np.sqrt(150.0 / 255.0))
    assert frame(imaging=replace(SHARP, exposure=3.0))[0, 0] == 255


@pytest.mark.parametrize(
    "room", [facing(normal=(0.0, 1.0, 0.0)), facing(centre=(0.0, -1.0, 0.0)), facing(centre=(5.0, 1.0, 0.0))]
)
def test_tags_turned_away_behind_or_outside_are_not_drawn(room):
    assert (frame(room=room) == SHARP.wall).all()
    assert not Renderer(CAMERA, room).inside(ORIGIN).any()


@pytest.mark.parametrize("imaging", [SHARP, Imaging(psf_sigma=2.0, noise=0.0)])
def test_a_cut_tag_is_a_part_of_the_whole(imaging):
    wide = replace(CAMERA, image_width=520.0, principal_point=(260.0, 120.0))
    room = facing(centre=(0.3, 1.0, 0.02), turn=0.3)
    cut, whole = frame(room=room, imaging=imaging), frame(camera=wide, room=room, imaging=imaging)
    np.testing.assert_allclose(cut.astype(int), whole[:, 100:420].astype(int), atol=1)
    assert not Renderer(CAMERA, room).inside(ORIGIN)[0]
    assert Renderer(wide, room).inside(ORIGIN)[0]


def test_what_is_behind_the_lens_does_not_come_back_upside_down():
    # A large tag on the floor from below the camera to behind it: nothing of it is above the horizon.
    floor = TaggedRoom(
        Tag(2.0), np.array([0]), np.array([[0.0, 0.5, -0.3]]), np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 1.0, 0.0]])
    )
    image = frame(room=floor)
    assert (image[:120] == SHARP.wall).all()
    assert (image[235:] != SHARP.wall).mean() > 0.9
    assert np.isnan(Renderer(CAMERA, floor).corners(ORIGIN)).any()


def test_a_surface_in_front_hides_a_tag():
    wall = ROOM.surfaces()[2]  # y_min, faces along y
    screen = replace(
        wall, origin=np.array([-1.0, 0.5, -1.0]), u=np.array([1.0, 0.0, 0.0]), normal=np.array([0.0, -1.0, 0.0])
    )
    open_view, hidden = frame(room=facing()), frame(room=facing(surfaces=[replace(screen, extent=(1.0, 2.0))]))
    alone = frame(room=facing(edge=1e-6, surfaces=[replace(screen, extent=(1.0, 2.0))]))
    np.testing.assert_array_equal(hidden[:, :159], alone[:, :159])
    np.testing.assert_array_equal(hidden[85:155, 162:], open_view[85:155, 162:])


def test_textured_walls_stay_the_same_from_frame_to_frame():
    room = facing(centre=(2.0, 3.999, 1.5), surfaces=ROOM.surfaces())
    pose = camera_pose([2.0, 2.0, 1.5], 0.1, 0.0)
    imaging = Imaging(noise=0.0, texture=8.0)
    first = frame(room=room, imaging=imaging, pose=pose, seed=1)
    np.testing.assert_array_equal(first, frame(room=room, imaging=imaging, pose=pose, seed=2))
    assert 3.0 < first[:80, :80].std() < 12.0


def test_defocus_softens_what_is_far():
    # The same picture from 1 m, where the lens is focused, and from 3 m: discs of 0 and 3.4 pixels.
    camera, imaging = replace(CAMERA, aperture=10.0), Imaging(noise=0.0)
    near, far = (frame(camera, facing((0.0, z, 0.0), edge=0.16 * z), imaging) for z in (1.0, 3.0))
    steepest = [np.abs(np.diff(image.astype(int), axis=1)).max() for image in (near, far)]
    assert steepest[1] < 0.8 * steepest[0]


def test_motion_blur_keeps_the_middle_and_the_light():
    imaging = Imaging(noise=0.0, defocus=False)
    motion = np.array([0.0, 0.0, 0.0, 0.02, 0.0, 0.0])  # 10 pixels
    still, moving = frame(imaging=imaging), frame(imaging=imaging, motion=motion)
    np.testing.assert_array_equal(frame(imaging=imaging, motion=np.zeros(6)), still)
    light = still.astype(float) - 150.0, moving.astype(float) - 150.0
    assert light[1].sum() == pytest.approx(light[0].sum(), rel=0.02)
    column = np.arange(320) + 0.5
    centre = [(np.abs(part) @ column).sum() / np.abs(part).sum() for part in light]
    assert centre[1] == pytest.approx(centre[0], abs=1.0)
    assert np.abs(np.diff(moving.astype(int), axis=1)).max() < np.abs(np.diff(still.astype(int), axis=1)).max() / 2


def test_a_turning_camera_smears_as_far_as_said():
    dark = replace(SHARP, wall=0.0)
    x, y = np.meshgrid(np.arange(320.0), np.arange(240.0))

    def spread(image):
        """Second moments of the light, pixels^2."""
        light = image / image.sum()
        dx, dy = x - (light * x).sum(), y - (light * y).sum()
        return np.array([(light * dx * dx).sum(), (light * dy * dy).sum()])

    grown = [spread(frame(imaging=replace(dark, motion_blur=8.0), seed=seed)) for seed in range(8)]
    grown -= spread(frame(imaging=dark))
    np.testing.assert_allclose(grown.sum(axis=1), 8.0**2 / 12.0, rtol=0.15)
    assert np.ptp(grown[:, 0]) > 2.0  # in directions of their own


def test_distorted_corners_are_where_the_picture_has_them():
    room = facing(centre=(0.16, 1.0, 0.1), edge=0.1, turn=0.4)
    renderer = Renderer(BENT, room, Imaging(noise=0.0))
    found = AprilTagDetector().detect(renderer.frame(ORIGIN, np.random.default_rng(0)))
    np.testing.assert_allclose(found.corners, renderer.corners(ORIGIN), atol=0.15)
    assert np.abs(renderer.corners(ORIGIN) - Renderer(CAMERA, room).corners(ORIGIN)).max() > 1.0


# 74 degrees to the borders, 109 to the corners: the picture is made of five faces of a cube.
LENS = {"distortion": (0.0035, 0.0007, -0.002, 0.0002), "distortion_model": "equidistant"}
FISHEYE = Camera(1.0, 1.0 / 400.0, 1.0 / 400.0, (510.0, 520.0), 1024, 1024, 0.0, **LENS)


def through(fisheye):
    """A room with many tags around a camera, the renderer and the pose."""
    room = Cuboid((4.0, 3.0, 3.0), (2.0, 1.0, 1.0), 0.5)
    deployment = UniformDeployment(60).draw(room, np.random.default_rng(0))
    pose = camera_pose(np.array([2.0, 1.4, 1.5]), 0.3, 0.1, 0.2)
    renderer = Renderer(fisheye, tagged_room(room, deployment, Tag(0.2)), Imaging(texture=4.0))
    return deployment, pose, renderer


def test_nothing_is_seen_beyond_the_round_image_of_a_fisheye():
    circle = 800.0
    _, pose, whole = through(FISHEYE)
    _, _, renderer = through(replace(FISHEYE, image_circle=circle))
    image = renderer.frame(pose, np.random.default_rng(0))
    pixels = np.stack(np.meshgrid(np.arange(1024) + 0.5, np.arange(1024) + 0.5), axis=-1)
    radius = np.linalg.norm(pixels - FISHEYE.principal_point, axis=-1)
    assert image[radius > circle / 2.0 + 1.0].mean() < 2.0 < 50.0 < image[radius < circle / 2.0 - 1.0].mean()
    farthest = np.linalg.norm(whole.corners(pose) - FISHEYE.principal_point, axis=-1).max(axis=-1)
    np.testing.assert_array_equal(renderer.inside(pose), whole.inside(pose) & (farthest <= circle / 2.0))
    found = AprilTagDetector().detect(image)
    inside = np.flatnonzero(renderer.inside(pose))
    assert set(inside) >= set(found.ids.tolist())
    assert 10 < len(found) < whole.inside(pose).sum() - 5


def test_a_detector_finds_tags_through_a_fisheye_where_the_model_says():
    deployment, pose, renderer = through(FISHEYE)
    found = AprilTagDetector().detect(renderer.frame(pose, np.random.default_rng(0)))
    whole = np.flatnonzero(renderer.inside(pose))
    assert set(whole) >= set(found.ids.tolist())
    assert len(found) > 0.9 * len(whole) > 20
    off = np.linalg.norm(found.corners - renderer.corners(pose)[found.ids], axis=-1)
    assert np.median(off) < 0.3
    assert off.max() < 1.0
    ahead = to_camera(pose, deployment.positions[found.ids])
    assert np.count_nonzero(ahead[:, 2] < 0.4 * np.linalg.norm(ahead, axis=-1)) >= 4  # beyond 66 degrees
    assert (ahead[:, 2] < 0.0).any()


def test_a_lens_that_distorts_blurs_as_much_as_any():
    # At 0.4 off the axis this lens shrinks by 0.76 along the radius and 0.92 across.
    camera = replace(CAMERA, image_width=480.0, principal_point=(240.0, 120.0), distortion=(-0.5, 0.0, 0.0, 0.0))
    room = replace(facing(centre=(0.4, 1.0, 0.0)), tag=Tag(0.06, quiet_zone=4.0))
    image = frame(camera, room, replace(SHARP, psf_sigma=2.0, black=5.0, white=245.0, wall=5.0)).astype(float)
    column, row = np.rint(Renderer(camera, room).corners(ORIGIN)[0].mean(axis=0)).astype(int)
    # The paper is 240 grey levels brighter than the wall: a step that is blurred rises by 240 / (sigma sqrt(2 pi)).
    lines = (image[row, :column], image[row, column:], image[:row, column], image[row:, column])
    # Away from the tag itself, which is darker.
    slopes = [np.diff(line)[:-12].max() for line in (lines[0], lines[1][::-1], lines[2], lines[3][::-1])]
    sigma = 240.0 / (np.array(slopes) * np.sqrt(2.0 * np.pi))
    assert np.exp(np.log(sigma).mean()) == pytest.approx(2.0, rel=0.08)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: Imaging(psf_sigma=-1.0), "psf_sigma must be at least 0"),
        (lambda: Imaging(defocus="sharp"), "defocus must be true or false, got .sharp."),
        (lambda: Imaging(white=10.0), "white must exceed black = 25, got 10"),
        (lambda: facing(number=587), r"ids must be in \[0, 586\] for family 36h11"),
        (lambda: replace(facing(), ups=np.array([[0.0, 1.0, 0.0]])), r"ups\[0\] must be perpendicular to normals\[0\]"),
        (lambda: replace(facing(), centres=np.zeros((2, 3))), "centres must be finite and have the shape"),
    ],
)
def test_bad_input_gets_a_sentence(make, sentence):
    with pytest.raises(InputError, match=sentence):
        make()
