"""Views of tags for a calibration: mosaics, and images of a board that a user took."""

import os
import shutil
import struct
import zlib
from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from lmd.core.checks import InputError
from lmd.detection.detectors import AprilTagDetector, ArucoDetector
from lmd.detection.mosaic import Mosaics
from lmd.detection.tag_views import BoardImages
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import camera_pose
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom
from lmd.scene.tag import Tag

pytestmark = pytest.mark.slow  # draws images

CAMERA = Camera(5.0, 0.0116, 0.0116, (400.0, 300.0), 800.0, 600.0, 5.0, 1778.0)
IMAGING = Imaging(texture=4.0)


def test_mosaics_are_views():
    views = Mosaics(40).views((CAMERA,), Tag(0.1), ArucoDetector(), IMAGING, np.random.default_rng(0))
    assert 20 < len(views) <= 40


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    """Eight images of six tags on a table, and the CSVs a user would write."""
    folder = tmp_path_factory.mktemp("board")
    (folder / "images").mkdir()
    x, y = np.meshgrid([0.0, 0.2, 0.4], [0.0, 0.2])
    centres = np.stack([x.ravel(), y.ravel(), np.zeros(6)], axis=1)
    normals, ids = np.tile([0.0, 0.0, 1.0], (6, 1)), np.arange(4, 10)
    renderer = Renderer(CAMERA, TaggedRoom(Tag(0.1), ids, centres, normals, np.tile([0.0, 1.0, 0.0], (6, 1))), IMAGING)
    rows = np.hstack([ids[:, None], centres, normals])
    pd.DataFrame(rows, columns=["id", "x", "y", "z", "nx", "ny", "nz"]).to_csv(folder / "tags.csv", index=False)
    table = []
    for i, height in enumerate(np.linspace(0.6, 4.0, 8)):
        pose = camera_pose([0.2 + 0.1 * height, 0.1 - 0.3 * height, height], 0.1, -1.2, 0.05 * i)
        cv2.imwrite(str(folder / "images" / f"{i}.png"), renderer.frame(pose, np.random.default_rng(i)))
        table.append([f"{i}.png", *pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat()])
    columns = ["image", "x", "y", "z", "qx", "qy", "qz", "qw"]
    pd.DataFrame(table, columns=columns).to_csv(folder / "poses.csv", index=False)
    return folder


def of(board, **changed):
    return BoardImages(**{"folder": str(board / "images"), "tags": str(board / "tags.csv"), **changed})


def views_of(images, camera=CAMERA):
    return images.views((camera,), Tag(0.1), AprilTagDetector(), IMAGING, np.random.default_rng(0))


def test_images_of_a_board_are_views(board):
    known, found = views_of(of(board, poses=str(board / "poses.csv"))), views_of(of(board))
    assert len(known) == 48  # also those of the far images, where nothing is found
    assert known.pitch.max() > 4.0 > 1.5 > known.pitch.min()
    assert known.seen[known.pitch > 3.0].all()
    assert not known.seen[known.pitch < 1.2].any()
    assert np.nanmax(known.error) < 1.0
    # By the corners found the poses are almost the same; images with fewer than two tags are left out.
    assert 0 < len(found) < len(known)
    np.testing.assert_allclose(found.pitch, known.pitch[: len(found)], rtol=0.01)
    np.testing.assert_array_equal(found.seen, known.seen[: len(found)])


def test_copies_of_images_of_a_board_count_once(board, tmp_path):
    shutil.copytree(board / "images", tmp_path / "images")
    shutil.copy(board / "images" / "0.png", tmp_path / "images" / "copy.png")
    once, twice = of(board), of(board, folder=str(tmp_path / "images"))
    assert twice.photographs == once.photographs == 8
    np.testing.assert_array_equal(views_of(twice).pitch, views_of(once).pitch)


def test_images_that_do_not_fit_are_refused(board, tmp_path):
    def refused(sentence, camera=CAMERA, **changed):
        with pytest.raises(InputError, match=sentence):
            views_of(of(board, **changed), camera)

    refused("folder is missing", folder=None)
    refused("folder: there is no folder 'nowhere'", folder="nowhere")
    refused("has no images", folder=str(tmp_path))
    refused("tags is missing", tags=None)
    refused("tolerance must be greater than 0", tolerance=0.0)
    refused("has 800 x 600 pixels, the camera 1600 x 1200", camera=replace(
        CAMERA, image_width=1600.0, image_height=1200.0))  # fmt: skip
    (tmp_path / "poses.csv").write_text("image,x,y,z,qx,qy,qz,qw\nother.png,0,0,1,0,0,0,1\n")
    refused("has no image 'other.png'", poses=str(tmp_path / "poses.csv"))
    (tmp_path / "poses.csv").write_text("x,y,z,qx,qy,qz,qw\n0,0,1,0,0,0,1\n")
    refused("lacks the column 'image'", poses=str(tmp_path / "poses.csv"))
    (tmp_path / "tags.csv").write_text("id,x,y,z,nx,ny,nz\n1,0,0,0,0,0,1\n1,1,0,0,0,0,1\n")
    refused("ids must be different whole numbers", tags=str(tmp_path / "tags.csv"))


def test_images_that_are_traps_are_not_opened(board, tmp_path):
    """A header of a few bytes that stands for gigabytes of pixels, and a pipe."""
    header = b"IHDR" + struct.pack(">IIBBBBB", 60_000, 60_000, 8, 0, 0, 0, 0)
    chunk = struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header))
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + chunk)
    with pytest.raises(InputError, match=r"a\.png' (cannot be read as an image|has 60000 x 60000 pixels)"):
        views_of(of(board, folder=str(tmp_path)))
    (tmp_path / "a.png").unlink()
    os.mkfifo(tmp_path / "a.png")
    with pytest.raises(InputError, match=r"^folder: .*a\.png' cannot be read: it is a pipe"):
        views_of(of(board, folder=str(tmp_path)))
