"""Bags of ROS 2: cameras, detections and poses; written and read by two libraries."""

import os

import numpy as np
import pytest
from support import bags as bf
from support import localisations as ld
from support.bags import GREY, SMALL, bag_of, images, only

from lmd.core.checks import InputError
from lmd.formats.bags import CAMERA_INFO, DETECTIONS, IMAGE, Bag, is_bag
from lmd.formats.calibrations import calibrated_camera
from lmd.formats.detection_formats import read_detections
from lmd.geometry.camera import Camera


def test_a_camera_info_is_a_calibration(tmp_path):
    camera = Camera(5.0, 0.0048, 0.0048, (801.0, 599.0), 1600, 1200, 0.0, distortion=(-0.1, 0.01, 0.0, 0.0, 0.0))
    path = bag_of(tmp_path / "a.mcap", bf.camera_info(camera), CAMERA_INFO, topic="/left/camera_info")
    found = calibrated_camera(str(path))
    np.testing.assert_allclose(found.focal_pixels, camera.focal_pixels)
    assert found.principal_point == pytest.approx((801.0, 599.0))
    assert found.distortion == camera.distortion
    assert calibrated_camera(str(path), "/left/camera_info") == found
    cut = bag_of(tmp_path / "b.mcap", bf.camera_info(camera) | {"binning_x": 2}, CAMERA_INFO)
    with pytest.raises(InputError, match="binned or cropped"):
        calibrated_camera(str(cut))


def test_detections_have_frames_for_images_without_a_tag(tmp_path):
    walk = ld.walked(1, frames=12).detected
    rows = []
    for frame in range(14):  # two images more, without a tag
        own = walk.frame == frame
        rows.append(("/tags", DETECTIONS, frame * 10**8, bf.tags(walk.ids[own], walk.corners[own])))
    found = read_detections(bf.write(tmp_path / "a.mcap", rows))
    assert len(found.times) == 14
    assert found.family == "36h11"
    assert found.times[3] == f"{bf.FIRST}.300000000"
    assert found.cameras == ("",)
    assert found.images.all()
    order = np.lexsort((found.ids, found.frame))
    np.testing.assert_array_equal(found.frame[order], walk.frame)
    np.testing.assert_array_equal(found.ids[order], walk.ids)
    np.testing.assert_allclose(found.corners[order], walk.corners)


def test_bags_without_what_is_wanted_are_refused_in_one_sentence(tmp_path):
    one = bf.image(GREY)
    two = bf.write(tmp_path / "two.mcap", [(topic, IMAGE, 0, one) for topic in ("/left", "/right")])
    tags = bag_of(tmp_path / "tags.mcap", bf.tags([], []), DETECTIONS, topic="/tags")
    with pytest.raises(InputError, match=r"two\.mcap' has 2 topics of Image or .*, /left, /right: set topic to"):
        images(two)
    assert list(images(two, topic="/left")) == ["/left"]
    assert list(images(two, count=2)) == ["/left", "/right"]
    with pytest.raises(InputError, match=r"two\.mcap' has no topic '/rear' of Image or CompressedImage; it has /left"):
        images(two, topic="/rear")
    with pytest.raises(InputError, match=r"tags\.mcap' has no topic of Image or .*; it has /tags \(apriltag_msgs"):
        images(tags)
    with pytest.raises(InputError, match=r"tags\.mcap' has no tag on /tags\.$"):
        read_detections(tags)
    with pytest.raises(InputError, match=r"two\.mcap' has no topic of AprilTagDetectionArray; it has /left"):
        read_detections(two)
    with pytest.raises(InputError, match=r"two\.mcap' has no topic of CameraInfo; it has /left \(sensor_msgs"):
        calibrated_camera(str(two))


def test_damaged_bags_are_refused_in_one_sentence(tmp_path):
    whole = bag_of(tmp_path / "whole.mcap", bf.image(GREY), count=20).read_bytes()
    damaged = tmp_path / "damaged.mcap"
    for content in (b"", b"text", whole[: len(whole) // 2], whole[:100] + bytes(200) + whole[300:]):
        damaged.write_bytes(content)
        with pytest.raises(
            InputError, match=r"^photographs: the bag '.*damaged\.mcap' (cannot be read|has )"
        ) as raised:
            list(only(damaged).read(0, 1, SMALL))
        assert "\n" not in str(raised.value)
    damaged.unlink()
    for path, metadata, message in (
        (tmp_path / "none.mcap", "", "there is no bag"),
        (tmp_path, "rosbag2_bagfile_information: 3\n", "cannot be read"),
        (tmp_path, "# " + "a" * 600_000, r"metadata\.yaml' cannot be read: it has 6e\+05 bytes; at most"),
        (tmp_path / "pipe.mcap", "", r"pipe\.mcap' cannot be read: it is a pipe\.$"),
    ):
        if path.name == "pipe.mcap":
            os.mkfifo(path)
        (tmp_path / "metadata.yaml").write_text(metadata)
        assert is_bag(path)
        with pytest.raises(InputError, match=message):
            Bag(path, "photographs")


def written(folder, rows=12, **compression):
    """A folder with an image by the library that reads it; all rows but twelve are 0."""
    from rosbags.rosbag2 import Writer

    from lmd.formats.bags import types

    kinds = types().types
    time = kinds["builtin_interfaces/msg/Time"](7, 5)
    data = np.pad(GREY, ((0, rows - 12), (0, 0))).ravel()
    message = kinds[IMAGE](kinds["std_msgs/msg/Header"](time, ""), rows, 16, "mono8", 0, 16, data)
    writer = Writer(folder, version=9, **compression.pop("storage", {}))
    if compression:
        writer.set_compression(**compression)
    with writer:
        topic = writer.add_connection("/image", IMAGE, typestore=types())
        writer.write(topic, 10**9, types().serialize_cdr(message, IMAGE))


@pytest.mark.parametrize("mode", ["FILE", "MESSAGE", "STORAGE"])
def test_what_is_compressed_expands_up_to_a_limit(mode, tmp_path, monkeypatch):
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin

    more = {"mode": CompressionMode[mode], "fmt": CompressionFormat.ZSTD}
    written(tmp_path / "drive", 20_000, storage={"storage_plugin": StoragePlugin.MCAP}, **more)
    assert len(list(Bag(tmp_path / "drive").messages("/image"))) == 1
    for name, limit in (("LARGEST_CHUNK", 100_000), ("LARGEST_FILE", 100_000), ("LARGEST_RATIO", 0)):
        monkeypatch.setattr(f"lmd.formats.bags.{name}", limit)
    with pytest.raises(InputError, match=r"^path: the bag '.*drive' has \d+ bytes in a compressed .*; at most \d+ a"):
        list(Bag(tmp_path / "drive").messages("/image"))


def test_a_folder_and_a_database_are_bags(tmp_path):
    written(tmp_path / "drive")
    for path in (tmp_path / "drive", *(tmp_path / "drive").glob("*.db3")):
        assert is_bag(path)
        found = only(path)
        assert found.names == ["7.000000005"]
        np.testing.assert_array_equal(next(found.read(0, 1, SMALL)), GREY)
