import numpy as np
from support.rooms import lab

from lmd.detection.frames import tagged_room
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import camera_pose
from lmd.geometry.squares import corners, upright
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.footprints import Footprints
from lmd.scene.tag import Tag

CAMERA = Camera(3.6, 0.02, 0.02, (160.0, 120.0), 320.0, 240.0, 1.0, 1000.0)
SHARP = Imaging(psf_sigma=0.0, defocus=False, noise=0.0)
GRID = np.stack(np.meshgrid(*2 * [np.linspace(0.0, 1.0, 9)]), axis=-1).reshape(-1, 2)


def test_a_tag_is_in_the_picture_where_its_line_of_sight_is_clear():
    room, tag, rng = lab(), Tag(0.2), np.random.default_rng(0)
    hung = Footprints(room, tag).draw(RandomDeployment(10), rng)
    nowhere = Deployment([[0.0, 0.0, -100.0]], [[0.0, 0.0, -1.0]])
    empty = Renderer(CAMERA, tagged_room(room, nowhere, tag), SHARP)
    seen = []
    for k in range(len(hung)):
        full = Renderer(CAMERA, tagged_room(room, hung[k : k + 1], tag), SHARP)
        centre, normal = hung.positions[k : k + 1], hung.normals[k : k + 1]
        a, b, _, d = corners(centre, normal, upright(normal)[1], tag.paper_edge)[0]
        points = a + GRID[:, :1] * (b - a) + GRID[:, 1:] * (d - a)
        for place in room.sample(15, rng):
            if (place - centre[0]) @ normal[0] < 0.2:
                continue
            way = centre[0] - place
            pose = camera_pose(place, np.arctan2(way[0], way[1]), np.arctan2(way[2], np.hypot(*way[:2])))
            clear = room.clear(np.broadcast_to(place, points.shape), points)
            if clear.all() == clear.any():  # it is wholly visible, or not at all
                images = [view.frame(pose, np.random.default_rng(0)) for view in (full, empty)]
                assert (images[0] != images[1]).any() == clear.all()
                seen.append(clear.all())
    assert 5 < sum(seen) < len(seen) - 5
