"""Maps of others, in the forms in which they come, against what their makers say of them."""

import json
from pathlib import Path

import numpy as np
import pytest
from map_files import assert_is, reader
from numpy.testing import assert_allclose

from lmd.core.checks import InputError
from lmd.formats.deployments import FileDeployment
from lmd.formats.tag_maps import read_deployment
from lmd.space.cuboid import Cuboid
from pipelines.app import CONF

REAL = Path(__file__).parents[2] / "../shared/real/layouts"
WPILIB = {
    "field": {"length": 8.0, "width": 4.0},
    "tags": [
        {
            "pose": {
                "rotation": {"quaternion": {"W": 0.0, "X": 0.0, "Y": 0.0, "Z": 1.0}},
                "translation": {"y": 1.0, "x": 7.5, "z": 0.5},
            },
            "ID": 4,
        }
    ],
}


@pytest.fixture
def read(tmp_path):
    return reader(tmp_path)


def test_wpilib_looks_along_x(read):
    assert_is(read(WPILIB), 4, [7.5, 1.0, 0.5], [-1, 0, 0])
    commented = json.dumps(WPILIB, indent=1).replace('"tags"', '/* all of them */ "tags"').replace("}\n ]", "},\n ]")
    assert_is(read(f"// mine: http://here\n{commented}"), 4, [7.5, 1.0, 0.5], [-1, 0, 0])
    assert_is(read({"name": "of 2027", "field-tags": WPILIB["tags"]}), 4, [7.5, 1.0, 0.5], [-1, 0, 0])


def test_frc971_looks_into_the_tag(read):
    # At the end of the field in positive x it looks back; the quaternion is that of its own map.
    text = """{
      /* Targets have positive Z axis pointing into the board */
      "target_poses": [{"id": 1, "position": {"x": 7.2, "y": -2.9, "z": 0.5},
                        "orientation": {"w": -0.5, "x": 0.5, "y": -0.5, "z": 0.5}},],
    }"""
    assert_is(read(text), 1, [7.2, -2.9, 0.5], [-1, 0, 0])
    # In degrees, as its map of 2025: that of 0, 0, 0 looks along -y, a positive turn about y, down, is clockwise.
    degrees = text.replace('"w": -0.5, "x": 0.5, "y": -0.5, "z": 0.5', '"x": 0, "y": 90, "z": 0')
    assert_is(read(degrees), 1, [7.2, -2.9, 0.5], [-1, 0, 0])
    assert_is(read(degrees.replace("90", "0")), 1, [7.2, -2.9, 0.5], [0, -1, 0])


def test_limelight_counts_from_the_middle(read):
    # The rotation of a tag that looks along (-0.5, 0.866, 0).
    turn = [-0.5, -0.866025, 0, 6.8, 0.866025, -0.5, 0, -3.8, 0, 0, 1, 1.3, 0, 0, 0, 1]
    tag = {"family": "apriltag3_36h11_classic", "id": 1, "size": 165.1, "transform": turn, "unique": 1}
    found = read({"type": "frc", "fiducials": [tag]})
    assert_allclose(found.normals[0], [-0.5, 0.866025, 0], atol=1e-6)
    assert_allclose(found.positions[0], [6.8, -3.8, 1.3])
    assert found.edges == [0.1651]
    assert_allclose(read({"fieldlength": 16.0, "fieldwidth": 8.0, "fiducials": [tag]}).positions[0], [14.8, 0.2, 1.3])


def test_a_transform_is_written_row_by_row(read):
    turn = [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 2.5, -1.25, 1.4, 1]
    with pytest.raises(
        InputError, match=r"tag 1: the last row of its transform must be 0, 0, 0, 1, it is 2\.5, -1\.25, 1\.4"
    ):
        read({"fiducials": [{"id": 1, "size": 165.1, "transform": turn}]})
    rows = np.reshape(turn, (4, 4)).T.ravel().tolist()
    assert_is(read({"fiducials": [{"id": 1, "size": 165.1, "transform": rows}]}), 1, [2.5, -1.25, 1.4], [0, 1, 0])
    with pytest.raises(InputError, match="the last row of its transform must be 0, 0, 0, 1, it is 0, 0, 0, 2"):
        read({"fiducials": [{"id": 1, "size": 165.1, "transform": [*rows[:15], 2]}]})
    with pytest.raises(InputError, match=r"size = 0.1651 is in millimetres here, which makes a tag of 0.0001651 m"):
        read({"fiducials": [{"id": 1, "size": 0.1651, "transform": rows}]})


def test_tagslam_places_bodies_and_tags_on_them(read):
    text = """
bodies:
 - wall:
     is_static: true
     type: simple
     default_tag_size: 0.2
     pose: {position: {x: 1, y: 2, z: 0}, rotation: {x: 0, y: 0, z: 1.5707963267948966}}
     tags:
       - {id: 2, pose: {position: {x: 1, y: 0, z: 0.5}, rotation: {x: 1.5707963267948966, y: 0, z: 0}}}
 - floor:
     is_static: true
     pose: {position: {x: 0, y: 0, z: 0}}
     board: {tag_start_id: 10, tag_size: 0.1, tag_spacing: 0.5, tag_rows: 2, tag_columns: 2}
 - rig: {is_static: false, type: simple}
"""
    found = read(text)
    assert found.ids.tolist() == [2, 10, 11, 12, 13]
    assert_allclose(found.positions[0], [1, 3, 0.5], atol=1e-12)
    assert_allclose(found.normals[0], [1, 0, 0], atol=1e-12)
    assert_allclose(found.positions[1:], [[0, 0, 0], [0.15, 0, 0], [0, 0.15, 0], [0.15, 0.15, 0]], atol=1e-12)
    assert found.edges.tolist() == [0.2, 0.1, 0.1, 0.1, 0.1]
    with pytest.raises(InputError, match="no body with tags is static: a map is of tags on bodies with is_static"):
        read(text.replace("is_static: true", "is_static: false"))
    with pytest.raises(InputError, match="the body 'floor' has no pose: give it one"):
        read(text.replace("pose: {position: {x: 0, y: 0, z: 0}}\n", "type: board\n"))


def test_fiducial_vlam_has_roll_pitch_yaw_or_a_quaternion(read):
    tag = {"id": 1, "u": 1, "f": 1, "xyz": [0, 0, 1], "rpy": [np.pi / 2, -0.0, -np.pi / 2]}
    assert_is(read({"marker_length": 0.16, "markers": [tag]}), 1, [0, 0, 1], [-1, 0, 0])
    older = {"id": 1, "u": 1, "f": 1, "t": [0, 0, 1], "q": [0.5, -0.5, -0.5, 0.5]}
    assert_is(read({"marker_length": 0.16, "markers": [older]}), 1, [0, 0, 1], [-1, 0, 0])


def test_aruco_has_corners_from_the_top_left(read):
    text = """%YAML:1.0
---
aruco_bc_dict: ARUCO_MIP_36h12
aruco_bc_nmarkers: 1
aruco_bc_mInfoType: {kind}
aruco_bc_markers:
   - {{ id:9, corners:[ [0., 1., 1.2], [0., 1.2, 1.2], [0., 1.2, 1.], [0., 1., 1.] ] }}
"""
    found = read(text.format(kind=1))
    assert_is(found, 9, [0, 1.1, 1.1], [1, 0, 0])
    assert_allclose(found.edges, [0.2])
    with pytest.raises(InputError, match="aruco_bc_mInfoType must be 1, metres, got 0"):
        read(text.format(kind=0))
    with pytest.raises(InputError, match="the marker 9 must be a square"):
        read(text.format(kind=1).replace("1.2, 1.2", "1.4, 1.2"))


def test_rtabmap_separates_tags_by_bars(read):
    found = read('"1 0 0 1 0 0 0|2 1 0 1 0 0 1.5707963267948966"\n')
    assert found.ids.tolist() == [1, 2]
    assert_allclose(found.ups, [[0, 1, 0], [-1, 0, 0]], atol=1e-12)


def test_tags_on_the_floor_of_duckietown(read):
    text = """
tile_size: 0.585
tiles: [[asphalt]]
objects:
  duckie: {kind: duckie, pose: {~SE2Transform: {p: [1, 1], theta_deg: 0}}}
  tag300:
    kind: floor_tag
    pose: {~SE2Transform: {p: [1.152, 1.008], theta_deg: 270}}
    tag: {~TagInstance: {family: 36h11, size: 0.065, tag_id: 300}}
"""
    assert_is(read(text), 300, [1.152, 1.008, 0], [0, 0, 1], [1, 0, 0])


def test_a_map_is_a_deployment_beside_the_walls_of_a_room(tmp_path):
    (tmp_path / "layout.json").write_text(json.dumps(WPILIB))
    room, rng = Cuboid((8.0, 4.0, 3.0), (7.0, 3.0, 1.0), 0.5), np.random.default_rng(0)
    with pytest.raises(InputError, match=r"free = false, but in .* hangs in mid-air"):
        FileDeployment(tmp_path / "layout.json").draw(room, rng)
    assert len(FileDeployment(tmp_path / "layout.json", free=True).draw(room, rng)) == 1


@pytest.mark.skipif(not REAL.exists(), reason="the files of others are not here")
def test_maps_of_others():
    counts = {}
    for path in sorted(REAL.iterdir()):
        if path.suffix != ".md" and path.name != "tagslam_test_13.yaml":
            counts[path.stem] = len(read_deployment(path, columns="clover"))
    assert counts == {
        "clover_nti_novgorod_mixed_sizes": 22,
        "clover_office_ceiling": 31,
        "fiducial_vlam_office": 12,
        "frc971_2023_epa": 8,
        "frc971_2023_target_map": 8,
        "tagslam_test_16": 1,
        "wpilib_2023-chargedup": 8,
        "wpilib_2025-reefscape-welded": 22,
    }
    with pytest.raises(InputError, match="the body 'board_6' has no pose"):  # TagSLAM is to find all of them
        read_deployment(REAL / "tagslam_test_13.yaml")
    # The same field by its makers and by a team, which counts from its middle.
    nominal, team = (
        read_deployment(REAL / name) for name in ("wpilib_2023-chargedup.json", "frc971_2023_target_map.json")
    )
    order = np.argsort(team.ids)
    assert_allclose(team.positions[order] + [16.54175 / 2, 8.0137 / 2, 0], nominal.positions, atol=0.01)
    assert_allclose(team.normals[order], nominal.normals, atol=1e-6)


@pytest.mark.skipif(not REAL.is_dir(), reason="files of others are not here")
def test_the_field_that_comes_along_is_that_of_its_makers():
    own = read_deployment(Path(CONF, "experiment/frc_2025.csv"))
    theirs = read_deployment(REAL / "wpilib_2025-reefscape-welded.json")
    assert own.ids.tolist() == theirs.ids.tolist() == list(range(1, 23))
    assert_allclose(own.positions, theirs.positions, atol=2e-4)  # drawings have hundredths of inches
    assert_allclose(own.normals, theirs.normals, atol=1e-6)
