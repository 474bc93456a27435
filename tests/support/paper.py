"""The paper's rooms, cameras and scene, with changes, and landmarks that face a camera."""

import math

import numpy as np

from lmd.geometry.camera import Camera
from lmd.scene import pdf
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.kernels import PROBABILITY_ONE
from lmd.sight.models.paper import Visibility
from lmd.space.cuboid import Cuboid

FIELDS = ("focal_length", "pixel_width", "pixel_height", "principal_point")
FIELDS += ("image_width", "image_height", "aperture", "focus_distance")
PAPER_CAMERA = dict(zip(FIELDS, (5.0, 0.0058, 0.0058, (800.0, 600.0), 1600.0, 1200.0, 10.0, 1778.0), strict=True))
PRINTED = (24.0, 0.0033, 0.0033, (960.0, 540.0), 1920.0, 1080.0, 8.57, math.inf)
PRINTED_EXPERIMENT_CAMERA = dict(zip(FIELDS, PRINTED, strict=True))
SIDE_WALLS = ("x_min", "x_max", "y_min", "y_max")
X, Y, Z = np.eye(3)


def paper_camera(**changes):
    return Camera(**(PAPER_CAMERA | changes))


def printed_experiment_camera(**changes):
    return Camera(**(PRINTED_EXPERIMENT_CAMERA | changes))


def paper_room(**changes):
    return Cuboid(**({"size": (7.5, 5.0, 6.0), "reachable_size": (6.0, 3.5, 4.5), "spacing": 0.5} | changes))


def experiment_room(**changes):
    fixed = {"size": (3.2, 3.2, 1.7), "reachable_size": (2.6, 2.6, 1.2), "spacing": 0.4, "walls": SIDE_WALLS}
    return Cuboid(**(fixed | changes))


def one_position_room(position=(2.0, 2.0, 2.0)):
    return Cuboid(size=tuple(2.0 * c for c in position), reachable_size=(0.1, 0.1, 0.1), spacing=1.0)


def paper_scene(room=None, camera=None, orientations=None, **visibility):
    return Scene(
        room or paper_room(),
        camera or paper_camera(),
        orientations or pdf.grid_with_ends(),
        Visibility(**({"thold": 0.28} | visibility)),
    )


def facing(camera_at, *points):
    points = np.array(points, dtype=float)
    normals = camera_at - points
    return Deployment(points, normals / np.linalg.norm(normals, axis=1, keepdims=True))


def chances(evaluator, deployment, n):
    """P_n at every position."""
    return evaluator.units(deployment.positions[None], deployment.normals[None], n)[0] / PROBABILITY_ONE
