"""Each map is read as its stack reads it, and one rendered image tells where the camera was."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import gtsam
import numpy as np
import pyapriltags
import pytest
import yaml
from support.references import parameters

from lmd.core.checks import InputError
from lmd.export.exports import Export, all_formats
from lmd.formats.tag_map import TagMap
from lmd.geometry.camera import Camera
from lmd.geometry.projection import intrinsics
from lmd.geometry.se3 import camera_pose
from lmd.geometry.squares import CORNERS, upright
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.render.room import TaggedRoom
from lmd.scene.deployment import Deployment
from lmd.scene.labels import Labels
from lmd.scene.tag import Tag
from lmd.space.cuboid import Cuboid

ROOM = Cuboid((6.0, 4.0, 2.8), (5.0, 3.0, 1.2), 0.5)
CAMERA = Camera(1.0, 1 / 560, 1 / 560, (810.0, 590.0), 1600, 1200, 0.0)
SHARP = Imaging(psf_sigma=0.5, noise=0.0)
POSE = camera_pose([3.1, 0.6, 1.1], 0.02, 0.3)  # sees the wall y_max, the ceiling, and a part of both other walls
EDGE = 0.3
DEPLOYMENT = Deployment.from_csv(Path(__file__).with_name("files") / "places.csv").with_surfaces(ROOM)
PLACES = dict(zip(DEPLOYMENT.ids.tolist(), zip(DEPLOYMENT.positions, DEPLOYMENT.normals, strict=True), strict=True))
MAPS = tuple(name for name, form in all_formats().items() if not form.on_paper)
UNIT = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2.0  # AprilTag's own order: from the bottom left, to the right


def tag_map(family="36h11"):
    return TagMap(ROOM, Tag(EDGE, family), DEPLOYMENT)


@pytest.fixture
def files(tmp_path):
    for name, write in Export(MAPS, "a4").writers(ROOM, Tag(EDGE), DEPLOYMENT).items():
        write(tmp_path / name)
    return tmp_path


@cache
def image(family):
    ups = upright(DEPLOYMENT.normals)[1]
    room = TaggedRoom(Tag(EDGE, family), DEPLOYMENT.ids, DEPLOYMENT.positions, DEPLOYMENT.normals, ups, ROOM.surfaces())
    return Renderer(CAMERA, room, SHARP).frame(POSE, np.random.default_rng(0))


@cache
def found_by_apriltag():
    """Detections of the AprilTag library itself: corners from the bottom left on, counter-clockwise."""
    detections = pyapriltags.Detector(families="tag36h11", nthreads=1, quad_decimate=1.0).detect(image("36h11"))
    return {tag.tag_id: tag.corners for tag in detections}


def found_by_opencv(family, name):
    """Detections of OpenCV itself, which counts pixels from the centre of the first one."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(image(family))
    return {int(number): square[0] + 0.5 for number, square in zip(ids.ravel(), corners, strict=True)}


def assert_camera_is_found(points, found):
    """The pose that maps `points` {id: (4, 3)} to the corners that were `found` is that of the camera."""
    seen = sorted(found)
    assert len(seen) >= 6
    objects, corners = (np.concatenate([source[number] for number in seen]) for source in (points, found))
    _, turn, shift = cv2.solvePnP(objects.astype(float), corners.astype(float), intrinsics(CAMERA), None)
    turn = cv2.Rodrigues(turn)[0]
    np.testing.assert_allclose(-turn.T @ shift.ravel(), POSE[:3, 3], atol=3e-3)
    assert np.degrees(np.linalg.norm(cv2.Rodrigues(turn @ POSE[:3, :3])[0])) < 0.1
    back = cv2.projectPoints(objects, cv2.Rodrigues(turn)[0], shift, intrinsics(CAMERA), None)[0][:, 0]
    assert np.abs(back - corners).max() < 1.0  # with two corners exchanged, no pose fits


def placed(pose, x, y):
    """Points of a tag's plane, by gtsam."""
    return np.array([pose.transformFrom(np.array([a, b, 0.0])) for a, b in zip(x, y, strict=True)])


def test_wpilib_reads_its_layout(files):
    apriltag = pytest.importorskip("robotpy_apriltag")
    geometry = pytest.importorskip("wpimath.geometry")
    layout = apriltag.AprilTagFieldLayout(str(files / "tags.wpilib.json"))
    assert (layout.getFieldLength(), layout.getFieldWidth()) == (6.0, 4.0)
    assert {tag.ID for tag in layout.getTags()} == set(PLACES)
    points = {}
    for number, (_, normal) in PLACES.items():
        pose = layout.getTagPose(number)
        out = geometry.Translation3d(1.0, 0.0, 0.0).rotateBy(pose.rotation())
        np.testing.assert_allclose([out.x, out.y, out.z], normal, atol=1e-9)  # +x is the outward normal
        # The vertices of PhotonVision's TargetModel: x out of the tag, y to the right, z up.
        ways = [geometry.Translation3d(0.0, EDGE * y, EDGE * z).rotateBy(pose.rotation()) for y, z in UNIT]
        points[number] = np.array([[pose.x + way.x, pose.y + way.y, pose.z + way.z] for way in ways])
    assert_camera_is_found(points, found_by_apriltag())


def test_apriltag_ros_reads_its_bundle(files):
    keys = yaml.safe_load((files / "tags.apriltag_ros.yaml").read_text())
    assert keys["standalone_tags"] == []
    (bundle,) = keys["tag_bundles"]
    points = {}
    for tag in bundle["layout"]:
        assert tag["size"] == EDGE
        turn = gtsam.Rot3.Quaternion(tag["qw"], tag["qx"], tag["qy"], tag["qz"])
        pose = gtsam.Pose3(turn, np.array([tag["x"], tag["y"], tag["z"]]))
        points[tag["id"]] = placed(pose, *(tag["size"] * UNIT.T))  # TagDetector::addObjectPoints
    assert_camera_is_found(points, found_by_apriltag())


def test_tagslam_reads_its_bodies(files):
    keys = yaml.safe_load((files / "tags.tagslam.yaml").read_text())
    body = keys["bodies"][0][keys["default_body"]]
    assert (body["is_static"], body["type"], body["default_tag_size"]) == (True, "simple", EDGE)
    points = {}
    for tag in body["tags"]:
        position, rotation = ([tag["pose"][key][axis] for axis in "xyz"] for key in ("position", "rotation"))
        pose = gtsam.Pose3(gtsam.Rot3.Expmap(np.array(rotation)), np.array(position))
        points[tag["id"]] = placed(pose, *(tag["size"] * UNIT.T))  # Tag::get_object_corners
    assert_camera_is_found(points, found_by_apriltag())


def read_marker_map(path):
    """As `MarkerMap::readFromFile` does, with OpenCV's own reader."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    assert storage.getNode("aruco_bc_mInfoType").real() == 1
    markers = storage.getNode("aruco_bc_markers")
    assert markers.size() == storage.getNode("aruco_bc_nmarkers").real()
    read = {}
    for i in range(markers.size()):
        corners = markers.at(i).getNode("corners")
        rows = [[corners.at(c).at(axis).real() for axis in range(3)] for c in range(4)]
        read[int(markers.at(i).getNode("id").real())] = np.array(rows)
    return storage.getNode("aruco_bc_dict").string(), read


def test_aruco_reads_its_map(files):
    dictionary, points = read_marker_map(files / "tags.aruco.yaml")
    assert dictionary == "TAG36h11"
    # The library finds corners clockwise from the top left.
    assert_camera_is_found(points, {number: corners[::-1] for number, corners in found_by_apriltag().items()})


def test_up_of_an_apriltag_is_the_same_to_the_aruco_library():
    # Of its list TAG36h11; DictionaryBased::touulong makes them of a picture, the last module being the last bit.
    for number, code in enumerate((0xD5D628584, 0xD97F18B49, 0xDD280910E)):
        inner = Tag(EDGE).picture(number)[1:-1, 1:-1]
        assert int("".join("1" if white else "0" for white in inner.ravel()), 2) == code


def test_opencv_finds_the_camera_by_the_map_of_its_own_family(tmp_path):
    write = Export(("aruco",), "a4").writers(ROOM, Tag(EDGE, "4x4_50"), DEPLOYMENT)["tags.aruco.yaml"]
    write(tmp_path / "map.yaml")
    name, points = read_marker_map(tmp_path / "map.yaml")
    assert name == "DICT_4X4_50"
    assert_camera_is_found(points, found_by_opencv("4x4_50", name))


def test_opencv_begins_at_the_third_corner_of_an_apriltag(files):
    found = found_by_opencv("36h11", "DICT_APRILTAG_36h11")
    points = read_marker_map(files / "tags.aruco.yaml")[1]
    assert_camera_is_found({number: np.roll(corners, 2, axis=0) for number, corners in points.items()}, found)


def test_the_plain_tables_hold_poses_and_corners(files):
    document = json.loads((files / "tags.json").read_text())
    assert (document["family"], document["edge"]) == ("36h11", EDGE)
    points, by_pose = {}, {}
    for tag in document["tags"]:
        names = ("bottom_left", "bottom_right", "top_right", "top_left")
        points[tag["id"]] = np.array([tag["corners"][name] for name in names])
        turn = gtsam.Rot3.Quaternion(*(tag["quaternion"][axis] for axis in "wxyz"))
        by_pose[tag["id"]] = placed(gtsam.Pose3(turn, np.array(tag["position"])), *(EDGE * UNIT.T))
    assert_camera_is_found(points, found_by_apriltag())
    assert_camera_is_found(by_pose, found_by_apriltag())
    table = np.genfromtxt(files / "tags.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    for row, tag in zip(table, document["tags"], strict=True):
        assert row["id"] == tag["id"]
        assert row["note"] == f"note {row['id']}"
        np.testing.assert_allclose([row[f"q{axis}"] for axis in "wxyz"], list(tag["quaternion"].values()))
        np.testing.assert_allclose([row[f"top_right_{axis}"] for axis in "xyz"], tag["corners"]["top_right"])


@pytest.mark.parametrize(
    ("family", "there"), [("36h11", "36h11"), ("41h12", "Standard41h12"), ("circle21h7", "Circle21h7")]
)
def test_the_node_of_ros_2_is_told_what_to_look_for(family, there, tmp_path):
    """`AprilTagNode` knows families by these names, and aborts on parameters of another type."""
    tags = TagMap(ROOM, Tag(1, family), DEPLOYMENT)
    all_formats()["apriltag_ros2"].write(tmp_path / "tags.yaml", tags=tags)
    found = parameters((tmp_path / "tags.yaml").read_text())["/**"]
    own = {"ids": list(PLACES), "frames": [f"tag_{number}" for number in PLACES], "sizes": [1.0] * len(PLACES)}
    assert found == {"family": there, "size": 1.0} | {f"tag.{name}": value for name, value in own.items()}
    assert {type(found["size"]), type(found["tag.sizes"][0])} == {float}


@pytest.mark.parametrize("family", ["36h11", "4x4_50"])
def test_rtabmap_finds_the_camera_by_opencv(family, tmp_path):
    form = all_formats()["rtabmap"]
    form.write(tmp_path / form.file, tags=tag_map(family))
    rows = [[float(value) for value in entry.split()] for entry in (tmp_path / form.file).read_text().split("|")]
    # As estimatePoseSingleMarkers has them: clockwise from the top left, y up.
    points = {
        int(number): placed(gtsam.Pose3(gtsam.Rot3.RzRyRx(*six[3:]), np.array(six[:3])), *(EDGE / 2.0 * CORNERS.T))
        for number, *six in rows
    }
    assert_camera_is_found(
        points, found_by_opencv(family, "DICT_APRILTAG_36h11" if family == "36h11" else "DICT_4X4_50")
    )


def test_limelight_counts_from_the_middle_of_the_field(files):
    document = json.loads((files / "tags.fmap").read_text())
    assert document["type"] == "frc"
    points = {}
    for tag in document["fiducials"]:
        assert (tag["family"], tag["size"]) == ("apriltag3_36h11_classic", 1000.0 * EDGE)
        pose = np.array(tag["transform"]).reshape(4, 4)
        middle = pose[:3, 3] + [3.0, 2.0, 0.0]
        points[tag["id"]] = np.array([middle + EDGE * (y * pose[:3, 1] + z * pose[:3, 2]) for y, z in UNIT])
    assert_camera_is_found(points, found_by_apriltag())


def test_by_hand():
    # A tag on the wall x = 0 looks along x: to its right is y, up is z.
    tags = tag_map()
    k = list(PLACES).index(21)
    np.testing.assert_allclose(tags.turns[k].as_matrix(), [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-12)
    np.testing.assert_allclose(tags.corners[k][:, 1:], [3.5, 1.9] + EDGE / 2.0 * CORNERS)
    assert not np.signbit(tags.corners[tags.corners == 0.0]).any()


UNFIT = [(name, "36h11, 25h9, .*", "4x4_50") for name, form in all_formats().items() if form.only_apriltag]
UNFIT += [(name, "36h11, .*", "41h12") for name in ("aruco", "rtabmap")]


@pytest.mark.parametrize(("name", "known", "family"), UNFIT)
def test_readers_are_given_only_families_that_they_know(name, known, family):
    with pytest.raises(InputError, match=f"^formats has {name}, which supports families {known}, not {family}"):
        Export([name], "a4").check(Tag(EDGE, family))


def test_what_cannot_be_written_is_said():
    with pytest.raises(InputError, match=r"edge must be given"):
        Export(["json"], "a4").check(Tag())
    with pytest.raises(InputError, match=r"edge must be given"):
        Export(["json"], "a4").writers(ROOM, Tag(), DEPLOYMENT)
    with pytest.raises(InputError, match=r"^family 16h5 has the tags 0 to 29, but a landmark has the id 77\.$"):
        TagMap(ROOM, Tag(EDGE, "16h5"), replace(DEPLOYMENT, labels=Labels(np.arange(70, 78))))
    Export([], "a4").check(Tag())
    assert Export([], "a4").writers(ROOM, Tag(), DEPLOYMENT) == {}
