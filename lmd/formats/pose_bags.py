"""Poses with covariances as a bag of ROS 2 (MCAP): `PoseWithCovarianceStamped`, and `tf`."""

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.core.tables import time_of
from lmd.formats.bags import types

POSE, TRANSFORMS = "geometry_msgs/msg/PoseWithCovarianceStamped", "tf2_msgs/msg/TFMessage"
MAP, CAMERA, TF = "map", "camera", "/tf"  # frames, and the topic of the transforms
LATEST = 2**31  # seconds that a stamp cannot reach


def write_pose_bag(
    path: Path, times: Sequence[str], topics: Mapping[str, tuple[FloatArray, FloatArray]], moving: str
) -> None:
    """Write poses of a camera (x right, y down, z the optical axis) in the frame `map`.

    Args:
        path: file of the bag.
        times: time of each pose, seconds, as texts.
        topics: poses by topic: position and quaternion `(F, 7)`, NaN where unknown, and covariance of position and of
            the rotation about the axes of the map `(F, 6, 6)`.
        moving: topic whose poses are also written as transforms.

    Raises:
        InputError: times are no seconds that ROS can hold, or `rosbags` is not installed.
    """
    store = types()
    from rosbags.rosbag2 import StoragePlugin, Writer

    stamps = [_nanoseconds(time) for time in times]
    rows = [
        (stamp, topic, poses[k], covariances[k])
        for topic, (poses, covariances) in topics.items()
        for k, stamp in enumerate(stamps)
        if np.isfinite(poses[k]).all()
    ]
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        with Writer(Path(folder) / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connections = {topic: writer.add_connection(topic, POSE, typestore=store) for topic in topics}
            transforms = writer.add_connection(TF, TRANSFORMS, typestore=store)
            for stamp, topic, pose, covariance in sorted(rows, key=lambda row: row[:2]):
                header = _header(store, stamp)
                writer.write(connections[topic], stamp, _pose(store, header, pose, covariance))
                if topic == moving:
                    writer.write(transforms, stamp, _transform(store, header, pose))
        (found,) = (Path(folder) / "bag").glob("*.mcap")
        found.replace(path)


def check_pose_bag(times: Sequence[str]) -> None:
    """Raise `InputError` if poses at these times cannot be written."""
    types()
    for time in times:
        _nanoseconds(time)


def _nanoseconds(time: str) -> int:
    value = time_of(time)
    if isinstance(value, str) or not 0 <= value < LATEST:
        raise InputError(f"a bag needs times of images in seconds, got {time!r}.", "bag")
    return int(value * 1_000_000_000)


def _header(store: Any, stamp: int) -> Any:
    kinds = store.types
    time = kinds["builtin_interfaces/msg/Time"](*divmod(stamp, 1_000_000_000))
    return kinds["std_msgs/msg/Header"](stamp=time, frame_id=MAP)


def _pose(store: Any, header: Any, pose: FloatArray, covariance: FloatArray) -> bytes:
    kinds = store.types
    point = kinds["geometry_msgs/msg/Point"](*pose[:3].tolist())
    turn = kinds["geometry_msgs/msg/Quaternion"](*pose[3:].tolist())
    whole = kinds["geometry_msgs/msg/Pose"](position=point, orientation=turn)
    known = kinds["geometry_msgs/msg/PoseWithCovariance"](pose=whole, covariance=covariance.ravel())
    return bytes(store.serialize_cdr(kinds[POSE](header=header, pose=known), POSE))


def _transform(store: Any, header: Any, pose: FloatArray) -> bytes:
    kinds = store.types
    vector = kinds["geometry_msgs/msg/Vector3"](*pose[:3].tolist())
    turn = kinds["geometry_msgs/msg/Quaternion"](*pose[3:].tolist())
    moved = kinds["geometry_msgs/msg/Transform"](translation=vector, rotation=turn)
    stamped = kinds["geometry_msgs/msg/TransformStamped"](header=header, child_frame_id=CAMERA, transform=moved)
    return bytes(store.serialize_cdr(kinds[TRANSFORMS](transforms=[stamped]), TRANSFORMS))
