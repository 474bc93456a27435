"""Rendered photographs of tags in a room, as a survey takes them."""

import cv2
import numpy as np
import walks

from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom
from lmd.scene.tag import Tag
from lmd.space.cuboid import Cuboid

ROOM = Cuboid((5.0, 4.0, 2.5), (4.0, 3.0, 1.5), 1.0)


def calibration(path, camera):
    """Write the calibration of a camera as ROS does."""
    (focal_u, focal_v), (u, v) = camera.focal_pixels, camera.principal_point
    matrix = [focal_u, 0, u - 0.5, 0, focal_v, v - 0.5, 0, 0, 1]
    path.write_text(
        f"image_width: {camera.image_width:.0f}\nimage_height: {camera.image_height:.0f}\n"
        f"camera_matrix: {{data: {[float(value) for value in matrix]}}}\n"
        f"distortion_model: plumb_bob\ndistortion_coefficients: {{data: [0, 0, 0, 0, 0]}}\n"
    )


def photograph(folder, tags, ids, frames, camera=walks.CAMERA, edge=walks.EDGE, first=0, seed=0):
    """Write a photograph from each of `frames` `(F, 4, 4)`, numbered from `first`."""
    room = TaggedRoom(Tag(edge), ids, tags[:, :3, 3], tags[:, :3, 2], tags[:, :3, 1], ROOM.faces())
    renderer = Renderer(camera, room, Imaging(psf_sigma=0.5, noise=2.0, texture=4.0))
    folder.mkdir(exist_ok=True)
    for number, pose in enumerate(frames, first):
        image = renderer.frame(pose, np.random.default_rng([seed, number]))
        cv2.imwrite(str(folder / f"{number:04d}.png"), image)
