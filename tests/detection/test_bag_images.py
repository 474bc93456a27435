"""Images in bags of ROS 2."""

import cv2
import numpy as np
import pytest
from support import bags as bf
from support import walks
from support.bags import GREY, SMALL, bag_of, only

from lmd.core.checks import InputError
from lmd.detection.photographed import ENCODINGS
from lmd.formats.bags import COMPRESSED, IMAGE


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_images_of_all_encodings_are_grey(encoding, tmp_path):
    """Encodings with colours have a grey picture; each row has three bytes more."""
    smooth = cv2.resize(np.array([[10, 200], [90, 30]], dtype=np.uint8), (16, 12), interpolation=cv2.INTER_LINEAR)
    each, _ = ENCODINGS[encoding]
    picture = np.repeat(smooth[..., None], each, axis=2)
    if encoding.startswith(("yuv", "uyvy", "yuyv")):
        picture[..., 1 if encoding in ("yuv422_yuy2", "yuyv") else 0] = 128
    if encoding in ("mono16", "16UC1"):
        picture[..., 0] = 77  # the low byte
    found = only(bag_of(tmp_path / "a.mcap", bf.image(picture, encoding, padding=3)))
    (image,) = found.read(0, 1, SMALL)
    assert image.shape == (12, 16)
    # OpenCV interpolates Bayer patterns.
    np.testing.assert_allclose(image[2:-2, 2:-2], smooth[2:-2, 2:-2], atol=12 if "bayer" in encoding else 1)


@pytest.mark.parametrize(
    ("encoding", "place"), [("rggb", (0, 0)), ("bggr", (1, 1)), ("grbg", (0, 1)), ("gbrg", (1, 0))]
)
def test_a_red_pixel_of_a_pattern_is_red(encoding, place, tmp_path):
    """Only red pixels are bright, so grey is 0.299 of white."""
    picture = np.zeros((12, 16), dtype=np.uint8)
    picture[place[0] :: 2, place[1] :: 2] = 200
    (image,) = only(bag_of(tmp_path / "a.mcap", bf.image(picture, f"bayer_{encoding}8"))).read(0, 1, SMALL)
    np.testing.assert_allclose(image[3:-3, 3:-3], 0.299 * 200, atol=2)


def test_compressed_images_are_decoded(tmp_path):
    content = cv2.imencode(".png", GREY)[1].tobytes()
    found = only(bag_of(tmp_path / "a.mcap", {"format": "png", "data": content}, COMPRESSED))
    (image,) = found.read(0, 1, SMALL)
    np.testing.assert_array_equal(image, GREY)


def test_images_are_taken_at_a_rate_and_in_the_order_of_their_times(tmp_path):
    """Thirty images a second with some jitter, of which two were recorded in the wrong order."""
    times = [k * 33_333_333 + (k % 3) * 300_000 for k in range(30)]
    rows = [("/image", IMAGE, at, bf.image(np.full((12, 16), k, dtype=np.uint8))) for k, at in enumerate(times)]
    rows[5], rows[6] = rows[6], rows[5]
    found = only(bf.write(tmp_path / "a.mcap", rows), rate=10.0)
    assert len(found.names) == 10
    assert found.names[0] == f"{bf.FIRST}.000000000"
    assert [int(image[0, 0]) for image in found.read(0, 10, SMALL)] == list(range(0, 30, 3))
    assert [int(image[0, 0]) for image in found.read(4, 6, SMALL)] == [12, 15]
    every = only(tmp_path / "a.mcap", rate=100.0)
    assert [int(image[0, 0]) for image in every.read(0, 30, SMALL)] == list(range(30))


def test_an_image_that_cannot_be_read_is_refused(tmp_path):
    one = bf.image(GREY)
    with pytest.raises(InputError, match=r"images encoded as 'nv21', not as one of mono8, "):
        list(only(bag_of(tmp_path / "odd.mcap", one | {"encoding": "nv21"})).read(0, 1, SMALL))
    with pytest.raises(
        InputError, match=r"has an image at 1700000000\.0* s with 192 bytes that do not match its pixels"
    ):
        list(only(bag_of(tmp_path / "odd.mcap", one | {"height": 13})).read(0, 1, SMALL))
    with pytest.raises(InputError, match=r"has 16 x 12 pixels, but the camera has 1600 x 1200"):
        list(only(bag_of(tmp_path / "odd.mcap", one)).read(0, 1, walks.CAMERA))
    with pytest.raises(InputError, match=r"of 'png' that cannot be decoded"):
        list(only(bag_of(tmp_path / "odd.mcap", {"format": "png", "data": b"xyz"}, COMPRESSED)).read(0, 1, SMALL))
