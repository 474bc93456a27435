import os
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from support.tables import rows

from lmd.core.checks import InputError
from lmd.detection.detectors import Detections
from lmd.detection.images import Photographs
from lmd.detection.photographed import detected_in
from lmd.geometry.camera import Camera

CAMERA = Camera(4.0, 0.02, 0.02, (160.0, 120.0), 320, 240, 0.0)


@pytest.mark.parametrize(("height", "width", "held", "brightest"), rows(__file__, "how a camera is held"))
def test_pixels_are_those_of_the_sensor_unless_only_turned_ones_fit(tmp_path, height, width, held, brightest):
    pixels, exif = np.zeros((height, width), dtype=np.uint8), Image.Exif()
    pixels[:8, :8], exif[0x0112] = 255, held
    Image.fromarray(pixels).save(tmp_path / "1.jpg", exif=exif)
    (image,) = Photographs(tmp_path).read(0, 1, CAMERA)
    assert image.shape == (240, 320)
    assert image[tuple(brightest)] > 200
    assert image.mean() < 2.0


def test_photographs_come_by_name(tmp_path):
    for number in (2, 1):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.full((240, 320), 100 * number, dtype=np.uint8))
    for name in ("notes.txt", "3.HEIC"):
        (tmp_path / name).write_text("")
    images = Photographs(tmp_path)
    assert images.unread == ["3.HEIC"]
    assert images.names == ["1.png", "2.png"]
    assert [image.mean() for image in images.read(0, 2, CAMERA)] == [100.0, 200.0]
    assert [image.mean() for image in images.read(1, 2, CAMERA)] == [200.0]


def test_a_name_that_is_no_utf_8_can_be_written(tmp_path):
    cv2.imwrite(str(tmp_path / "cafe.png"), np.full((240, 320), 7, dtype=np.uint8))
    os.rename(tmp_path / "cafe.png", os.fsencode(tmp_path) + b"/caf\xe9.png")
    images = Photographs(tmp_path)
    assert images.names == ["caf\\udce9.png"]
    images.names[0].encode()
    assert [image.mean() for image in images.read(0, 1, CAMERA)] == [7.0]


def test_a_folder_that_cannot_be_read_is_refused(tmp_path, monkeypatch):
    def closed(_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", closed)
    with pytest.raises(InputError, match=r"^folder: the folder '.*' cannot be read \(Permission denied\)\.$"):
        Photographs(tmp_path)


def test_images_that_are_traps_are_not_opened(tmp_path):
    """A header of a few bytes that stands for gigabytes of pixels, and a pipe."""
    header = b"IHDR" + struct.pack(">IIBBBBB", 60_000, 60_000, 8, 0, 0, 0, 0)
    chunk = struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header))
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + chunk)
    with pytest.raises(InputError, match=r"a\.png' (cannot be read as an image|has 60000 x 60000 pixels)"):
        list(Photographs(tmp_path).read(0, 1, CAMERA))
    (tmp_path / "a.png").unlink()
    os.mkfifo(tmp_path / "a.png")
    with pytest.raises(InputError, match=r"^folder: .*a\.png' cannot be read: it is a pipe"):
        list(Photographs(tmp_path).read(0, 1, CAMERA))


class Blind:
    """Finds no tag."""

    def detect(self, image):
        return Detections(np.empty(0, dtype=np.int64), np.empty((0, 4, 2)))


def test_photographs_without_a_tag_say_so(tmp_path):
    cv2.imwrite(str(tmp_path / "1.png"), np.zeros((240, 320), dtype=np.uint8))
    with pytest.raises(InputError, match=r"^photographs: no tag of this family is found in any of 1 images"):
        detected_in(Photographs(tmp_path), CAMERA, Blind(), 8, map, workers=1)
