import cv2
import numpy as np
import pytest
from PIL import Image

from lmd.core.checks import InputError
from lmd.detection.images import Photographs, Video
from lmd.scene.camera import Camera

CAMERA = Camera(4.0, 0.02, 0.02, (160.0, 120.0), 320, 240, 0.0)
RATE, FRAMES = 10, 20


@pytest.fixture
def video(tmp_path):
    """A video that grows brighter with every frame."""
    path = tmp_path / "walk.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), RATE, (320, 240))
    for number in range(FRAMES):
        writer.write(np.full((240, 320, 3), 10 * number, dtype=np.uint8))
    writer.release()
    return path


@pytest.mark.parametrize(("rate", "step"), [(5, 2), (100, 1), (3, 3)])
def test_so_many_frames_a_second_are_taken_of_a_video(video, rate, step):
    images = Video(video, rate)
    assert [float(name) for name in images.names] == pytest.approx([k / RATE for k in range(0, FRAMES, step)])
    whole = [image.mean() for image in images.read(0, len(images.names), CAMERA)]
    np.testing.assert_allclose(whole, np.arange(0, FRAMES, step) * 10.0, atol=3.0)
    part = [image.mean() for image in images.read(2, 5, CAMERA)]
    assert part == whole[2:5]


def test_a_video_of_another_size_is_refused(video):
    other = Camera(4.0, 0.02, 0.02, (160.0, 120.0), 322, 240, 0.0)
    with pytest.raises(InputError, match=r"has 320 x 240 pixels, the camera 322 x 240\.$"):
        list(Video(video, 5).read(0, 1, other))


def test_what_is_no_video_is_refused(tmp_path):
    (tmp_path / "walk.mp4").write_text("nothing")
    with pytest.raises(InputError, match=r"cannot be read as a video\.$"):
        Video(tmp_path / "walk.mp4", 5)
    with pytest.raises(InputError, match=r"^path: there is no file"):
        Video(tmp_path / "none.mp4", 5)


@pytest.mark.parametrize(
    ("height", "width", "held", "brightest"),
    [(240, 320, 3, (0, 0)), (240, 320, 6, (0, 0)), (320, 240, 6, (0, -1))],  # 6: to be turned clockwise
)
def test_pixels_are_those_of_the_sensor_unless_only_turned_ones_fit(tmp_path, height, width, held, brightest):
    pixels, exif = np.zeros((height, width), dtype=np.uint8), Image.Exif()
    pixels[:8, :8], exif[0x0112] = 255, held
    Image.fromarray(pixels).save(tmp_path / "1.jpg", exif=exif)
    (image,) = Photographs(tmp_path).read(0, 1, CAMERA)
    assert image.shape == (240, 320)
    assert image[brightest] > 200
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
