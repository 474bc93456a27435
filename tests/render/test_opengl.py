"""Rendered frames beside those of OpenGL, an independent renderer: only room and pictures of tags are the same."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from lmd.detection.detectors import AprilTagDetector, corner_error
from lmd.geometry.camera import Camera
from lmd.geometry.projection import image_size, intrinsics
from lmd.geometry.se3 import camera_pose, inverse
from lmd.geometry.squares import upright
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom
from lmd.scene.tag import Tag

moderngl = pytest.importorskip("moderngl")

CAMERA = Camera(5.0, 0.01, 0.01, (330.0, 235.0), 640.0, 480.0, 1.0, 1000.0)
SHARP = Imaging(psf_sigma=0.0, defocus=False, noise=0.0, supersampling=8)
SAMPLES = 8  # of OpenGL, along each axis of a pixel
FISHEYE = (0.02, -0.03, 0.01, -0.002)
PIECES = 24  # that each edge of a paper is cut into, so that straight ones show how the lens bends the whole
VERTEX = """
#version 330
in vec4 place; in vec2 texel; out vec2 at;
void main() { gl_Position = place; at = texel; }
"""
FRAGMENT = """
#version 330
uniform sampler2D picture; in vec2 at; out float grey;
void main() { grey = texture(picture, at).r; }
"""


@pytest.fixture(scope="module")
def context():
    try:
        made = moderngl.create_context(standalone=True, backend="egl")
    except Exception as error:  # of the driver, or of what looks for it
        pytest.skip(f"OpenGL without a screen (EGL) is not to be had here: {error}")
    made.gc_mode = "auto"  # or what a test has made is kept until the end
    yield made
    made.release()


@pytest.fixture(scope="module")
def room():
    """Tags before the camera, turned every way, some behind others, and too far apart to go through each other."""
    rng, tag = np.random.default_rng(0), Tag(0.22)
    centres = np.empty((0, 3))
    while len(centres) < 14:
        centre = np.array([2.2, 0.0, 0.0]) + rng.uniform(-1.0, 1.0, 3) * [0.8, 1.2, 0.9]
        if (np.linalg.norm(centres - centre, axis=1) > np.sqrt(2.0) * tag.paper_edge).all():
            centres = np.vstack([centres, centre])
    normals = rng.normal(size=centres.shape) * 0.4 - [1.0, 0.0, 0.0]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return TaggedRoom(tag, np.arange(20, 34), centres, normals, upright(normals)[1])


def by_opengl(context, camera, room, pose, imaging):
    """The image, `(h, w)`: papers cut into small pieces, whose corners OpenCV projects."""
    width, height = image_size(camera)
    size = width * SAMPLES, height * SAMPLES
    buffer = context.simple_framebuffer(size, components=1, dtype="f4")
    buffer.use()
    buffer.clear(imaging.wall / 255.0)
    context.enable_only(moderngl.DEPTH_TEST)
    program = context.program(vertex_shader=VERTEX, fragment_shader=FRAGMENT)
    share = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, PIECES + 1)] * 2), axis=-1)
    cells = np.stack(
        [share[:-1, :-1], share[:-1, 1:], share[1:, :-1], share[1:, :-1], share[:-1, 1:], share[1:, 1:]], 2
    )
    texels = cells.reshape(-1, 2)  # right and down from the paper's corner
    back = inverse(pose)
    for number, centre, normal, up in zip(room.ids, room.centres, room.normals, room.ups, strict=True):
        picture = np.pad(
            np.where(room.tag.picture(int(number)), imaging.white, imaging.black), 1, constant_values=imaging.white
        )
        texture = context.texture(picture.shape[::-1], 1, (picture / 255.0).astype("f4").tobytes(), dtype="f4")
        texture.filter = moderngl.NEAREST, moderngl.NEAREST
        texture.use()
        right = np.cross(up, normal)
        world = centre + room.tag.paper_edge * ((texels[:, :1] - 0.5) * right + (0.5 - texels[:, 1:]) * up)
        local = world @ back[:3, :3].T + back[:3, 3]
        lens, still = np.array(camera.distortion or np.zeros(5)), np.zeros(3)
        by_opencv = cv2.fisheye.projectPoints if camera.distortion_model == "equidistant" else cv2.projectPoints
        image = by_opencv(local[:, None], still, still, intrinsics(camera), lens)[0][:, 0]
        depth = local[:, 2]
        place = np.stack([2.0 * image[:, 0] / width - 1.0, 1.0 - 2.0 * image[:, 1] / height, depth / 10.0], axis=-1)
        vertices = np.column_stack([place * depth[:, None], depth, texels])
        array = context.vertex_array(program, context.buffer(vertices.astype("f4").tobytes()), "place", "texel")
        array.render(moderngl.TRIANGLES)
    grey = np.frombuffer(buffer.read(components=1, dtype="f4"), dtype="f4").reshape(size[::-1])[::-1]
    return np.rint(255.0 * cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA)).astype(np.uint8)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lens", "roll"),
    [
        ((), 0.0),
        ((), 0.5),
        ((-0.2, 0.03, 0.004, -0.005), 0.5),
        ((0.2, 0.05, -0.004, 0.003), 0.5),
        ((0.1, -0.04, 0.001, 0.0, 0.004, 0.3, -0.07, 0.006, 0.01, 0.0, -0.02, 0.01), 0.5),
        ("fisheye", 0.5),
    ],
)
def test_frames_are_those_of_opengl(context, room, lens, roll):
    model = {"distortion": FISHEYE, "distortion_model": "equidistant"} if lens == "fisheye" else {"distortion": lens}
    camera, pose = replace(CAMERA, **model), camera_pose([0.0, 0.0, 0.0], np.pi / 2, 0.0, roll)
    renderer, detector = Renderer(camera, room, SHARP), AprilTagDetector()
    ours = renderer.frame(pose, np.random.default_rng(0))
    theirs = by_opengl(context, camera, room, pose, SHARP)
    found, again = detector.detect(ours), detector.detect(theirs)
    assert len(found) >= 8
    np.testing.assert_array_equal(found.ids, again.ids)
    assert corner_error(found.corners, again.corners).max() < 0.1
    off = np.abs(ours.astype(float) - theirs)
    # Bent images are made of straight ones, pixel by pixel, which softens the outlines of modules.
    assert np.quantile(off, 0.999) < (45.0 if lens else 15.0)
    assert off.mean() < 1.0
