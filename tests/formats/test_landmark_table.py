"""Tags in tables and texts of everybody's own: what their values are taken for, and what is asked about."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from lmd.core.checks import InputError
from lmd.formats.deployments import FileDeployment
from lmd.formats.tag_maps import read_deployment
from pipelines.pipeline import with_file

# On a wall in the south of what looks at it: it faces -y, and hangs upright.
WALL = "7 2.0 0.0 1.2 0.70710678 0 0 0.70710678\n8 4.0 0.0 1.5 0.70710678 0 0 0.70710678\n"
ANGLES = "7 2.0 0.0 1.2 1.5708 0 0\n8 4.0 0.0 1.5 1.5708 0 0\n"


@pytest.fixture
def read(tmp_path):
    def read_text(text, **options):
        (tmp_path / "map").write_text(text)
        return read_deployment(tmp_path / "map", **options)

    return read_text


def assert_faces(found, positions, normal, up):
    assert_allclose(found.positions, positions)
    assert_allclose(found.normals, [normal] * len(found), atol=1e-5)
    assert_allclose(found.ups, [up] * len(found), atol=1e-5)


@pytest.mark.parametrize(
    "text",
    [
        "id,x,y,z,qx,qy,qz,qw\n" + WALL.replace(" ", ","),
        "id x y z qx qy qz qw\n" + WALL,
        "# id x y z qx qy qz qw\n" + WALL,
        "# Tag_ID, pos_x [m], pos_y [m], pos_z [m], q_x, q_y, q_z, q_w\n" + WALL,
        WALL,
        WALL.replace("7 2.0", "tag36h11:7 2.0"),
        "id,x,y,z,roll,pitch,yaw\n" + ANGLES.replace(" ", ","),
        "# id x y z roll pitch yaw: ROS's, in rad\n" + ANGLES,
        ANGLES,
    ],
)
def test_a_table_or_a_text_says_places_and_turns(read, text):
    found = read(text)
    assert found.ids.tolist() == [7, 8]
    assert not found.has_own_edges
    assert_faces(found, [[2, 0, 1.2], [4, 0, 1.5]], [0, -1, 0], [0, 0, 1])
    assert "is read as id x y z " in found.note
    assert "the axes x, y, z of a tag point right, up, out, and axes can say otherwise" in found.note


def test_the_axes_of_a_tag_are_what_is_said(read):
    rng = np.random.default_rng(0)
    turn = Rotation.random(random_state=rng)
    quaternion = ",".join(map(str, turn.as_quat()))
    for axes, out, up in (
        (None, [0, 0, 1], [0, 1, 0]),
        (["right", "down", "into"], [0, 0, -1], [0, -1, 0]),  # AprilTag's
        (["out", "right", "up"], [1, 0, 0], [0, 0, 1]),  # WPILib's
    ):
        found = read(f"id,x,y,z,qx,qy,qz,qw\n3,1,2,3,{quaternion}\n", axes=axes)
        assert_allclose(found.normals[0], turn.apply(out), atol=1e-12)
        assert_allclose(found.ups[0], turn.apply(up), atol=1e-12)
    roll, pitch, yaw = 0.3, -0.2, 1.1
    expected = Rotation.from_euler("xyz", [roll, pitch, yaw])  # about fixed axes, as ROS's setRPY
    found = read(f"id,x,y,z,roll,pitch,yaw\n3,1,2,3,{roll},{pitch},{yaw}\n")
    assert_allclose(found.normals[0], expected.apply([0, 0, 1]), atol=1e-12)
    for axes in (["right", "up", "into"], ["right", "up"], "right up out", [1, 2, 3]):
        with pytest.raises(InputError, match="axes must be three of right, left, up, down, out, into"):
            FileDeployment("mine.csv", axes=axes)


def test_further_columns_of_a_table_stay_and_edges_are_metres(read):
    found = read("id,x,y,z,qx,qy,qz,qw,size,place\n7,2,0,1,0,0,0,1,0.15,door\n8,3,0,1,0,0,0,1,,stairs\n")
    assert found.labels.columns == {"place": ["door", "stairs"]}
    assert_allclose(found.edges, [0.15, np.nan])
    with pytest.raises(InputError, match=r"map line 2: edge = 150 looks like millimetres; edges are in metres"):
        read("id,x,y,z,qx,qy,qz,qw,edge\n7,2,0,1,0,0,0,1,150\n")


def test_a_family_is_a_column(read):
    text = "id,x,y,z,nx,ny,nz,family\n1,0,1,0,1,0,0,TAG16h5\n2,0,2,0,1,0,0,\n"
    assert len(read(text, family="16h5")) == len(read(text)) == 2
    with pytest.raises(
        InputError, match=r"^family=16h5 is needed: the tags of .*map are of that family, and not of 36h11"
    ):
        read(text, family="36h11")
    with pytest.raises(InputError, match="of the families 16h5 and 36h11"):
        read(text.replace("0,\n", "0,36h11\n"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# id x y z: tags on the floor\n1 0.3 0.5 0\n", "not how they are turned: it needs the columns nx,ny,nz"),
        ("id,x,y,z\n1,0.3,0.5,0\n", "not how they are turned"),
        ("id,x,y,z,yaw\n1,0.3,0.5,0,0\n", "of roll, pitch, yaw it lacks roll, pitch"),
        ("id,x,y,z,ori_w,qx,qy\n1,0.3,0.5,0,1,0,0\n", "of qx, qy, qz, qw it lacks qz"),
        ("id,x,y,z,rot_a,rot_b,rot_c\n1,0.3,0.5,0,0,0,0\n", "not how they are turned"),
        ("id,x,y,z,roll,pitch,yaw\n1,0,0,0,90,0,0\n", "tag 1: roll = 90 looks like degrees"),
        ("id,x,y,z,roll_deg,pitch_deg,yaw_deg\n1,0,0,0,1,0,0\n", "its column 'roll_deg' is in another unit"),
        ("id,x[mm],y[mm],z[mm],qx,qy,qz,qw\n1,0,0,0,0,0,0,1\n", r"its column 'x\[mm\]' is in another unit"),
        ("id,x,y,z,qx,qy,qz,qw\n1,0,0,0,0,0,0,2\n", "must have length 1, it has 2"),
        (
            "x,y,z,nx,ny,nz\n0,0,0,0,1,0\n",
            "it needs a column id with the number of each tag, such as 7 or tag36h11:7; it",
        ),
        ("name,x,y,z,nx,ny,nz\ntag36h11,0,0,0,0,1,0\n", "it needs a column id"),
        (",x,y,z,nx,ny,nz\n0,0,0,0,0,1,0\n1,1,0,0,0,1,0\n", "it needs a column id"),  # a table of pandas counts lines
        ("id,name,x,y,z,nx,ny,nz\n0,tag36h11:7,0,0,0,0,1,0\n", "'id' and 'name' have different numbers of tags"),
        ("id,x,y,z,nx,ny,nz\ntag36h11:7,0,0,0,0,1,0\n7,1,0,0,0,1,0\n", "id 7 belongs to 2 landmarks"),
        ("id,family,x,y,z,nx,ny,nz\ntag36h11:7,16h5,0,0,0,0,1,0\n", "of the families 16h5 and 36h11"),
        ("id x y z qx qy qz qw\n1 0 0 0 0 0 0\n", "has 7 values, the header 8"),
        ("# id x y z qx qy qz qw\n1 0 0 0 0 0 0\n", "line 2 has 7 values, but a comment names 8"),
        ("7,2,0,1,0,0,0,1\n", "it has no header: its first line must name the columns"),
        ("7 2.0 0.0 1.2\n8 4.0 0.0 1.5\n", "line 2, '8 4.0 0.0 1.5': an edge of 4 m would be none of a tag. What"),
        ("7 0.5 0.0 1.2\n8 1.0 0.0 1.5\n", "nearly every tag would have an edge of its own"),
        ("7 0.001 0.0 1.2\n", "an edge of 0.001 m would be none of a tag"),
        ("7 0.5 0 1.2 1.57 0 0\n8 0.7 0 1.2 1.57 0 0\n", "it may be id x y z roll pitch yaw, or Clover's"),
        ("7 0.5 0 1.2 0 1 0 0\n", "it may be id x y z qx qy qz qw, or Clover's"),
        ("7 0.5 0 1.2 0.1 0 0.6 0 0.8\n8 0.5 0 1.2 0.1 0 0.6 0 0.8\n", "What are its values"),
        ("# id length x y z\n7 3.0 1 2 0\n", "length = 3 is in metres here, which makes a tag of 3 m: is that meant"),
        ("7.5 0.3 1 2\n", "line 1: the id must be a whole number from 0, got '7.5'"),
        ("7 0.15 2 0 1.2 0 0 90\n", "tag 7: roll = 90 looks like degrees"),
        ("7 2.0 0 1.2 90 0 0|8 4 0 1.2 90 0 0\n", "tag 7: roll = 90 looks like degrees"),
    ],
)
def test_what_is_not_sure_is_asked_about(read, text, message, tmp_path):
    with pytest.raises(InputError, match=message) as refused:
        read(text)
    assert str(tmp_path / "map") in str(refused.value)


def test_texts_of_clover_are_said_to_be_taken_for_that(read):
    for text in ("1 0.3 0.5 0\n2 0.3 -0.5 0\n", "1 0.3 0.5 0 0 0 0 0\n", "1 0.3 0.5 0 1 0 0 0\n"):
        found = read(text)
        assert_allclose(found.positions[0, :2], [0.5, 0])
        assert "is read as Clover's id length x y" in found.note
    assert not read("# id\tlength\tx\ty\tz\trot_z\trot_y\trot_x\n1\t0.3\t0.5\t0\t0\t0\t0\t0\n").note


def test_a_path_alone_means_a_file():
    assert with_file(["+deployment.path=a.csv", "seed=1"], "evaluate") == [
        "deployment=file",
        "deployment.path=a.csv",
        "seed=1",
    ]
    for given in (["deployment=mine", "deployment.path=a"], ["run=out", "deployment.path=a"], ["deployment.free=true"]):
        assert with_file(given, "optimise") == given
    assert with_file(["deployment.path=a"], "size") == ["deployment.path=a"]  # it takes no deployment
