import os
import pickle
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.tables import rows

from lmd.core.checks import InputError
from lmd.detection.video import Video, container_of
from lmd.geometry.camera import Camera

CAMERA = Camera(4.0, 0.02, 0.02, (160.0, 120.0), 320, 240, 0.0)
UPRIGHT = Camera(4.0, 0.02, 0.02, (120.0, 160.0), 240, 320, 0.0)
RATE, FRAMES = 10, 20
RAW = Path(__file__).with_name("files") / "raw.h264"
STREAM = Path(__file__).parents[2] / "../shared/cases/video/live.webm"  # written without a length


def film(path, code="MJPG", frames=None):
    """A video that grows brighter with every frame, or of the given frames."""
    frames = [np.full((240, 320), 10 * k, dtype=np.uint8) for k in range(FRAMES)] if frames is None else frames
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*code), RATE, (320, 240))
    for frame in frames:
        writer.write(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


@pytest.fixture
def video(tmp_path):
    return film(tmp_path / "walk.avi")


def means(images, first, last, camera=CAMERA):
    return [image.mean() for image in images.read(first, last, camera)]


@pytest.mark.parametrize(("rate", "step"), [(5, 2), (100, 1), (3, 3)])
def test_so_many_frames_a_second_are_taken_of_a_video(video, rate, step):
    images = Video(video, rate)
    assert [float(name) for name in images.names] == pytest.approx([k / RATE for k in range(0, FRAMES, step)])
    whole = means(images, 0, len(images.names))
    np.testing.assert_allclose(whole, np.arange(0, FRAMES, step) * 10.0, atol=3.0)
    assert means(images, 2, 5) == whole[2:5]
    assert images.remarks == []


@pytest.mark.parametrize(("name", "code"), rows(__file__, "kinds of videos"))
def test_videos_of_many_kinds_are_read_from_any_frame_on(tmp_path, name, code):
    images = Video(film(tmp_path / name, code), 100)
    assert [float(name) for name in images.names] == pytest.approx([k / RATE for k in range(FRAMES)], abs=2e-3)
    whole = means(images, 0, FRAMES)
    np.testing.assert_allclose(whole, np.arange(FRAMES) * 10.0, atol=5.0)
    again = pickle.loads(pickle.dumps(images))  # as another process has it
    assert [means(again, k, k + 1) for k in (17, 3, 11)] == [[whole[k]] for k in (17, 3, 11)]


def turned(source, target, degrees):
    """The same MP4 with another matrix in the header of its track, which says how the camera was held."""
    content = bytearray(source.read_bytes())
    place = content.index(b"tkhd") + 4 + 40
    cosine, sine = {90: (0, 1), 180: (-1, 0), 270: (0, -1)}[degrees]
    matrix = (cosine << 16, sine << 16, 0, -sine << 16, cosine << 16, 0, 0, 0, 1 << 30)
    content[place : place + 36] = struct.pack(">9i", *matrix)
    target.write_bytes(content)
    return target


@pytest.mark.parametrize("degrees", [90, 180, 270])
def test_frames_are_those_of_the_sensor_unless_only_turned_ones_fit(tmp_path, degrees):
    pixels = np.zeros((240, 320), dtype=np.uint8)
    pixels[:60, :80] = 255
    plain = film(tmp_path / "plain.mp4", "mp4v", [pixels] * 3)
    path = turned(plain, tmp_path / "held.mp4", degrees)
    assert cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_ORIENTATION_META) == degrees
    (image,), (as_stored,) = (list(Video(each, 5).read(0, 1, CAMERA)) for each in (path, plain))
    np.testing.assert_array_equal(image, as_stored)
    assert image[:50, :70].mean() > 200.0
    if degrees == 180:
        with pytest.raises(InputError, match=r"has 320 x 240 pixels, but the camera has 240 x 320\.$"):
            list(Video(path, 5).read(0, 1, UPRIGHT))
    else:
        (image,) = Video(path, 5).read(0, 1, UPRIGHT)
        np.testing.assert_array_equal(image, np.rot90(as_stored, -degrees // 90))


def test_a_raw_stream_is_read_to_its_end():
    """It has neither a number of frames nor times; its macroblocks hold 20, 30, ... as they are, of 32 x 32 pixels."""
    images, camera = Video(RAW, 100), Camera(4.0, 0.02, 0.02, (16.0, 16.0), 32, 32, 0.0)
    assert images.names == [f"{k / 25:.6f}" for k in range(FRAMES)]
    (remark,) = images.remarks
    assert remark.endswith("raw.h264' has no times: OpenCV's rate of 25 frames a second is assumed")
    assert not images.is_random_access
    whole = means(images, 0, FRAMES, camera)
    np.testing.assert_allclose(np.diff(whole), 10.0 * 255 / 219, atol=1.0)  # 16 to 235 are black and white
    assert means(images, 9, 12, camera) == whole[9:12]


@pytest.mark.skipif(not STREAM.exists(), reason="a file that is not part of the project")
def test_a_stream_that_was_written_without_a_length_is_read_to_its_end():
    images = Video(STREAM, 1000)
    assert images.names == [f"{k / 25:.6f}" for k in range(120)]
    assert images.remarks == []


def stated(path, frames):
    """The same AVI, whose header says that it has other frames."""
    content = bytearray(path.read_bytes())
    for name, place in ((b"avih", 16), (b"strh", 32)):
        at = content.index(name) + 8 + place
        assert struct.unpack("<I", content[at : at + 4]) == (FRAMES,)
        content[at : at + 4] = struct.pack("<I", frames)
    path.write_bytes(content)


@pytest.mark.parametrize("frames", [7, FRAMES + 1])
def test_a_header_that_is_wrong_does_not_say_where_a_video_ends(video, frames):
    stated(video, frames)
    images = Video(video, 100)
    np.testing.assert_allclose(means(images, 0, len(images.names)), np.arange(FRAMES) * 10.0, atol=3.0)
    np.testing.assert_allclose(means(images, 15, 17), [150.0, 160.0], atol=3.0)
    assert images.remarks == []


def test_a_video_that_was_cut_says_so(tmp_path):
    path = film(tmp_path / "walk.mkv")
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])
    images = Video(path, 100)
    count = len(images.names)
    assert 10 < count < 15
    assert images.remarks == [f"'{path}' ends after {count} of the 20 frames that its header states"]
    np.testing.assert_allclose(means(images, 0, count), np.arange(count) * 10.0, atol=3.0)


@pytest.mark.parametrize(("name", "text"), rows(__file__, "files that name another one"))
def test_a_file_that_names_another_one_is_refused_before_it_is_opened(tmp_path, monkeypatch, name, text):
    other = film(tmp_path / "walk01.mp4", "mp4v")
    monkeypatch.setattr(cv2, "VideoCapture", None)
    (tmp_path / name).write_text(text.format(other))
    with pytest.raises(InputError, match=r"cannot be read as a video: it is a text, such as a playlist, which names"):
        Video(tmp_path / name, 5)


def test_a_playlist_behind_the_first_bytes_of_a_video_is_not_opened(tmp_path):
    """A text may have a byte at each place where a transport stream has it."""
    film(tmp_path / "walk.mp4", "mp4v")
    lines = b"G#EXTM3U\n#EXTINF:2.0,\nwalk.mp4\n"
    fake = tmp_path / "walk.ts"
    fake.write_bytes(b"".join(lines.ljust(188, b"\n") for _ in range(8)))
    assert container_of(fake.read_bytes()).name == "MPEG-TS"
    before = dict(os.environ)
    with pytest.raises(InputError, match="cannot be read as a video"):
        _ = Video(fake, 5).names
    assert dict(os.environ) == before


def test_a_name_that_is_an_address_for_the_decoder_is_a_name_of_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    film(tmp_path / "walk.avi").rename("concat:walk.avi")
    assert len(Video("concat:walk.avi", 100).names) == FRAMES


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "cannot be read as a video: it is empty; give MP4 and MOV, "),
        (b"nothing", "it is a text, such as a playlist"),
        (b"\0\1\2\3nothing", "it does not begin like a video"),
        (b"\x89PNG\r\n\x1a\n", "is a single image: give a folder of photographs, or a video"),
        (b"\0\0\0\x18ftypisom\0\0\0\0isom", "cannot be read as a video: OpenCV cannot open it"),
    ],
)
def test_what_is_no_video_is_refused(tmp_path, content, reason):
    (tmp_path / "walk.mp4").write_bytes(content)
    with pytest.raises(InputError, match=reason):
        Video(tmp_path / "walk.mp4", 5)


def test_what_is_no_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.mp4")
    with pytest.raises(InputError, match=r"it is a pipe\.$"):
        Video(tmp_path / "pipe.mp4", 5)
