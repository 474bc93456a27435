"""Tags in worlds of Gazebo: names, frames, sides of plates and models beside a world."""

import numpy as np
import pytest
from map_files import assert_is, reader
from map_samples import plate, world
from numpy.testing import assert_allclose

from lmd.core.checks import InputError

UPRIGHT = "0.01 0.3 0.3"  # a plate across x
WALL = (
    '<model name="wall"><pose>2.905 0 1 0 0 0</pose><link name="l"><collision name="c"><geometry><box>'
    "<size>0.2 4 2</size></box></geometry></collision></link></model>"
)


@pytest.fixture
def read(tmp_path):
    return reader(tmp_path)


@pytest.mark.parametrize(
    ("picture", "family", "number"),
    [
        ("Apriltag36_11_00007", "36h11", 7),
        ("tag36h11_00012.png", "36h11", 12),
        ("apriltag_36h11_id1.png", "36h11", 1),
        ("tag16_05_00003", "16h5", 3),
        ("tagStandard41h12_00005", "41h12", 5),
        ("tag21_07_00002", "circle21h7", 2),
        ("aruco_5x5_250_id1", "5x5_250", 1),
        ("aruco_marker_250_6x6_1", "6x6_250", 1),
        ("aruco_marker_6cm_238", None, 238),
        ("aruco_marker_original_582", "aruco_original", 582),
        ("aruco/DICT_4X4_50-17", "4x4_50", 17),
        ("Aruco/Marker3", None, 3),
        ("aruco_000.png", None, 0),
        ("apriltag_12", None, 12),
    ],
)
def test_names_of_pictures_have_the_family_and_the_number(picture, family, number, read):
    found = read(world(plate("thing", picture, "0.3 0.3 0.01")))
    assert found.ids.tolist() == [number]
    if family is not None:
        other = "36h11" if family != "36h11" else "16h5"
        with pytest.raises(InputError, match=rf"^family={family} is needed"):
            read(world(plate("thing", picture, "0.3 0.3 0.01")), family=other)


@pytest.mark.parametrize("picture", ["Gazebo/Grey", "stage_1", "cottage_4", "bricks", "arucotag", "aruco_6cm"])
def test_what_has_no_tag_s_name_is_no_tag(picture, read):
    with pytest.raises(InputError, match="no model, picture or material has a name with the number of a tag"):
        read(world(plate("thing", picture, "0.3 0.3 0.01")))


def test_a_lying_plate_shows_its_tag_above_with_x_up(read):
    # CreateBox gives the upper side the corners (+,-,+), (+,+,+), (-,+,+), (-,-,+) from the top right one on.
    lying = plate("tag", "tag36h11_7", "0.3 0.3 0.01", "1 2 0.5 0 0 0")
    assert_is(read(world(lying)), 7, [1, 2, 0.505], [0, 0, 1], [1, 0, 0])
    assert "plates that lie show their tag on the upper side" in read(world(lying)).note
    # Turned over, the other side is above, whose up is minus x of it.
    over = plate("tag", "tag36h11_7", "0.3 0.3 0.01", f"1 2 0.5 {np.pi} 0 0")
    assert_is(read(world(over)), 7, [1, 2, 0.505], [0, 0, 1], [-1, 0, 0])


@pytest.mark.parametrize(("pose", "out"), [("2.8 0.5 1 0 0 0", [-1, 0, 0]), ("3.01 0.5 1 0 0 0", [1, 0, 0])])
def test_a_plate_on_a_body_shows_its_tag_away_from_it(pose, out, read):
    found = read(world(WALL + plate("tag", "tag36h11_7", UPRIGHT, pose)))
    x = float(pose.split()[0])
    assert_is(found, 7, [x + 0.005 * out[0], 0.5, 1], out)


def test_a_plate_with_a_back_shows_its_tag_in_front(read):
    shape = f"<geometry><box><size>{UPRIGHT}</size></box></geometry>"
    back = f"<visual name='back'><pose>-0.01 0 0 0 0 0</pose>{shape}</visual>"
    text = world(plate("gate", "tag36h11_7", UPRIGHT, "3 0.5 1 0 0 0").replace("</link>", f"{back}</link>"))
    assert_is(read(text), 7, [3.005, 0.5, 1], [1, 0, 0])
    assert_is(read(text.replace("<sdf", "<!-- -- --><sdf")), 7, [3.005, 0.5, 1], [1, 0, 0])


def test_a_free_upright_plate_is_asked_about(read):
    text = world(plate("gate", "tag36h11_7", UPRIGHT, "3 0.5 1 0 0 0"))
    with pytest.raises(
        InputError,
        match=r"the tag 7 \(v, l, gate\) is on both sides of an upright plate: axes=\[out,right,up\] takes that "
        r"towards \+x of it, axes=\[into,left,up\] takes that towards -x of it",
    ):
        read(text)
    assert_is(read(text, axes=["out", "right", "up"]), 7, [3.005, 0.5, 1], [1, 0, 0])
    assert_is(read(text, axes=["into", "left", "up"]), 7, [2.995, 0.5, 1], [-1, 0, 0])


def test_the_side_of_a_mesh_is_asked_about(read):
    mesh = "<geometry><mesh><uri>model://aruco_marker_4/m.dae</uri></mesh></geometry>"
    text = world(
        f'<model name="m"><pose>1 0 1 0 0 0</pose><link name="l"><visual name="v">{mesh}</visual></link></model>'
    )
    with pytest.raises(InputError, match=r"the tag 4 \(v, l, m\) is on a model whose shape does not say which side"):
        read(text)
    assert_is(read(text, axes=["out", "right", "up"]), 4, [1, 0, 1], [1, 0, 0])


def test_a_plane_shows_its_picture_with_y_up(read):
    shape = "<geometry><plane><normal>0 0 1</normal><size>1 1</size></plane></geometry>"
    seen = "<material><pbr><metal><albedo_map>tag36h11_7.png</albedo_map></metal></pbr></material>"
    model = f'<model name="m"><pose>1 2 3 0 0 1.5707963267948966</pose><link name="l"><visual name="v">{shape}{seen}'
    assert_is(read(world(f"{model}</visual></link></model>")), 7, [1, 2, 3], [0, 0, 1], [-1, 0, 0])


def test_poses_are_relative_to_what_is_around_or_to_a_named_frame(read):
    around = '<frame name="shelf"><pose>0 0 1 0 0 0</pose></frame>'
    inner = plate("tag", "tag36h11_7", "0.3 0.3 0.01", "0.1 0 0 0 0 0").replace(
        "<pose>", '<pose relative_to="shelf">', 1
    )
    outer = f'<model name="rack"><pose>1 2 0 0 0 1.5707963267948966</pose>{around}{inner}<link name="b"/></model>'
    # The rack is turned to the left, so that its x is the y of the world.
    assert_is(read(world(outer)), 7, [1, 2.1, 1.005], [0, 0, 1], [0, 1, 0])
    base = '<frame name="a" attached_to="rack::b"><pose>0 0 0.5 0 0 0</pose></frame>'
    beside = plate("other", "tag36h11_8", "0.3 0.3 0.01", "0 0 0 0 0 0").replace("<pose>", '<pose relative_to="a">', 1)
    found = read(world(base + outer + beside))
    assert found.ids.tolist() == [7, 8]
    assert_allclose(found.positions[1], [1, 2, 0.505], atol=1e-12)
    with pytest.raises(InputError, match="a pose is relative to the frame 'shelf', which is not in the file"):
        read(world(outer.replace(around, "")))
    # A model that Gazebo has flattened: its links have :: in their names.
    tag = plate("tag", "tag36h11_9", "0.3 0.3 0.01").replace(
        '<link name="l">', '<link name="l"><pose relative_to="x::b"/>'
    )
    base = '<link name="x::b"><pose>0 0 1 0 0 0</pose></link><link name="l">'
    assert_is(read(world(tag.replace('<link name="l">', base))), 9, [0, 0, 1.005], [0, 0, 1], [1, 0, 0])
    with pytest.raises(InputError, match="the frame 'a' refers to itself"):
        read(world('<frame name="a" attached_to="a"/>' + beside))


def test_saved_states_and_degrees_and_quaternions(read):
    lying = plate("tag", "tag36h11_7", "0.3 0.3 0.01", "1 2 0.5 0 0 0")
    saved = '<state world_name="w"><model name="tag"><pose>4 5 0.5 0 0 0</pose></model></state>'
    assert_is(read(world(lying + saved)), 7, [4, 5, 0.505], [0, 0, 1], [1, 0, 0])
    degrees = lying.replace("<pose>1 2 0.5 0 0 0", '<pose degrees="true">1 2 0.5 0 0 90')
    assert_is(read(world(degrees)), 7, [1, 2, 0.505], [0, 0, 1], [0, 1, 0])
    quaternion = lying.replace("<pose>1 2 0.5 0 0 0", '<pose rotation_format="quat_xyzw">1 2 0.5 0 0 0 1')
    assert_is(read(world(quaternion)), 7, [1, 2, 0.505], [0, 0, 1], [1, 0, 0])
    for pose, message in (
        ("1 2", "the pose of 'tag' must be x y z roll pitch yaw, got '1 2'"),
        ("1 2 0 0 0 x", "the pose of 'tag' must be x y z roll pitch yaw"),
    ):
        with pytest.raises(InputError, match=message):
            read(world(lying.replace("1 2 0.5 0 0 0", pose)))


def test_models_are_read_from_their_folders_beside_the_world(read, tmp_path):
    include = "<include><uri>model://mine_tag</uri><name>a</name><pose>1 2 0 0 0 0</pose></include>"
    with pytest.raises(InputError, match="no model, picture or material has a name with the number of a tag"):
        read(world(include))
    folder = tmp_path / "models" / "mine_tag"
    folder.mkdir(parents=True)
    model = plate("mine", "tag36h11_7", "0.3 0.3 0.01", "9 9 9 0 0 0")
    (folder / "model.sdf").write_text(f'<sdf version="1.6">{model}</sdf>')
    assert_is(read(world(include)), 7, [1, 2, 0.005], [0, 0, 1], [1, 0, 0])  # an include's pose replaces the model's
    assert_is(read(world(include.replace("<pose>1 2 0 0 0 0</pose>", ""))), 7, [9, 9, 9.005], [0, 0, 1], [1, 0, 0])
    assert_is(read(f'<sdf version="1.6">{model}</sdf>'), 7, [9, 9, 9.005], [0, 0, 1], [1, 0, 0])
    # The models of koide3/gazebo_apriltag are known: plates of 1 x 1 x 0.01 m.
    known = include.replace("mine_tag", "Apriltag36_11_00003")
    assert_is(read(world(known)), 3, [1, 2, 0.005], [0, 0, 1], [1, 0, 0])
    elsewhere = include.replace("mine_tag", "aruco_marker_5")
    with pytest.raises(InputError, match="or put the folder of the model beside the file"):
        read(world(elsewhere))
    with pytest.raises(InputError, match="the model 'a' is placed by a placement_frame, which is not read"):
        read(world(include.replace("<name>", "<placement_frame>f</placement_frame><name>")))
