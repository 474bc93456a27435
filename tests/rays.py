"""Images of rays, for tests of calibrations against the formulas of their programs."""

import cv2
import numpy as np

from lmd.geometry.camera import PIXEL_CENTRE
from lmd.geometry.projection import project

RAYS = np.array([[0.0, 0.0, 1.0], [0.3, -0.2, 1.0], [-0.4, 0.25, 1.0], [0.1, 0.35, 1.0]])


def images(camera, rays=RAYS):
    """Images of rays, from the centre of the first pixel."""
    return project(camera, np.eye(4), rays) - PIXEL_CENTRE


def by_opencv(matrix, lens, rays=RAYS):
    return cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.array(matrix, dtype=float), np.array(lens))[0][:, 0]


def radial(rays, k1, k2, k3):
    x, y = (rays[:, :2] / rays[:, 2:]).T
    s = x * x + y * y
    return x, y, s, 1 + k1 * s + k2 * s**2 + k3 * s**3
