"""The adjuster beside OpenCV's calibration, which shares no code with it; 3 seconds."""

import numpy as np
from support import localisations as ld
from support import walks

from lmd.adjust.intrinsics import intrinsics_of, with_intrinsics
from lmd.adjust.sightings import SQUARE
from lmd.core.optional import optional
from lmd.geometry.camera import PIXEL_CENTRE
from lmd.geometry.se3 import act, inverse, log, pose_of
from lmd.localise.localise import localise
from lmd.scene.tag import Tag


def test_intrinsics_and_poses_are_those_of_calibrate_camera():
    """A map without errors: both fit the same corners, and differ by less than half a standard deviation."""
    cv2 = optional("cv2", "estimators")
    walk = ld.walked(3, frames=50, place=1e-5, turn=1e-5)
    given = with_intrinsics(walks.CAMERA, intrinsics_of(walks.CAMERA) + np.array([3.0, 3.0, 3.0, -3.0, 0, 0, 0, 0, 0]))
    found = localise(walk.detected, [given], Tag(walks.EDGE), walks.constant_errors(ld.NOISE), walk.known)
    (camera,) = found.found.calibrated
    corners = act(walk.true, walks.EDGE / 2.0 * SQUARE)
    counts = np.bincount(walk.detected.frame, minlength=50)
    frames = np.flatnonzero(counts > 1)
    world, image = (
        [each[walk.detected.frame == f].reshape(-1, n).astype(np.float32) for f in frames]
        for each, n in ((corners[walk.detected.ids], 3), (walk.detected.corners - PIXEL_CENTRE, 2))
    )
    start = intrinsics_of(given)
    matrix = np.array([[start[0], 0.0, start[2] - PIXEL_CENTRE], [0.0, start[1], start[3] - PIXEL_CENTRE], [0, 0, 1]])
    size, flags = (int(given.image_width), int(given.image_height)), cv2.CALIB_USE_INTRINSIC_GUESS
    _, matrix, _, turns, ways = cv2.calibrateCamera(world, image, size, matrix, np.zeros(5), flags=flags)
    other = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2] + PIXEL_CENTRE, matrix[1, 2] + PIXEL_CENTRE])
    np.testing.assert_array_less(np.abs(intrinsics_of(camera.found)[:4] - other), 0.5 * camera.sigma[:4])
    turned = np.stack([cv2.Rodrigues(turn)[0] for turn in turns])
    poses = inverse(pose_of(turned, np.array(ways)[..., 0]))
    off = log(inverse(found.found.poses.frames[frames]) @ poses)
    sigma = np.sqrt(np.diagonal(found.found.frame_covariances[frames], axis1=1, axis2=2))
    assert np.median(np.abs(off) / sigma) < 0.3
