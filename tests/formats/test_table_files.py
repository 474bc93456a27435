"""Tables of poses, tags and detections: small files of each kind, and properties over all of them."""

import csv
import io
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, strategies
from scipy.spatial.transform import Rotation
from support.thorough import examples

from lmd.core.checks import InputError
from lmd.formats.columns import LAYOUTS, POSES, TAGS, VOCABULARY
from lmd.formats.detection_formats import read_detections
from lmd.formats.tag_maps import read_deployment
from lmd.formats.trajectories import TrajectoryFile

TABLES = yaml.safe_load(Path(__file__).with_name("files").joinpath("tables.yaml").read_text(encoding="utf-8"))
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # from a camera to its body
ALL = [(of, name) for of in ("poses", "tags", "detections") for name in TABLES[of]]


def read(of, path, columns=None, frame="optical", **_):
    if of == "poses":
        return TrajectoryFile(str(path), frame, columns=columns).trajectory
    return read_deployment(path, columns=columns) if of == "tags" else read_detections(path)


def write(tmp_path, content):
    path = tmp_path / "file"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def check_poses(found, row):
    drive = TABLES["drives"][row["drive"]]
    time, rows = np.array(drive["time"]), np.array(drive["poses"])
    turns = Rotation.from_quat(rows[:, 3:]).as_matrix() @ (OPTICAL if row.get("body") else np.eye(3))
    np.testing.assert_allclose(found.time, time, atol=1e-6)
    np.testing.assert_allclose(found.poses[:, :3, 3], rows[:, :3], atol=1e-6)
    np.testing.assert_allclose(found.poses[:, :3, :3], turns, atol=1e-6)


def check_tags(found, row):
    assert found.ids[0] == 7
    for name, values, expected in (
        ("positions", found.positions, [2.0, 0.0, 1.2]),
        ("normal", found.normals, row.get("normal", [0.0, -1.0, 0.0])),
        ("up", found.ups, row.get("up", [0.0, 0.0, 1.0])),
    ):
        np.testing.assert_allclose(values[0], expected, atol=1e-5, err_msg=name)
    np.testing.assert_equal(found.edges[0], row.get("edge", np.nan))


def check_detections(found, row):
    assert (found.times[0], found.ids[0]) == (row.get("time", "0.325917"), 18)
    assert (found.cameras, found.family) == ((row.get("camera", ""),), row.get("family"))
    np.testing.assert_allclose(found.corners[0], [[10, 10], [20, 10], [20, 20], [10, 20]])


CHECKS = {"poses": check_poses, "tags": check_tags, "detections": check_detections}


@pytest.mark.parametrize(("of", "name"), ALL)
def test_a_file_has_its_values(of, name, tmp_path):
    row = TABLES[of][name]
    CHECKS[of](read(of, write(tmp_path, row["text"]), **row), row)


@pytest.mark.parametrize("row", TABLES["refused"], ids=lambda row: f"{row['of']} {row['words'][:40]}")
def test_a_bad_file_is_refused_in_one_sentence(row, tmp_path):
    path = write(tmp_path, row["text"])
    with pytest.raises(InputError) as error:
        read(**row, path=path)
    message = str(error.value)
    assert re.search(row["words"], message)
    assert "\n" not in message
    assert path.name in message or row.get("rate") or error.value.argument


HEADED = [(of, name) for of, name in ALL if re.match(r"[%,A-Z_a-z][^\n{]*,", TABLES[of][name]["text"])]
# Of columns of times the first counts, and WPILib's drawings are known by their header.
HEADED = [(of, name) for of, name in HEADED if name != "two columns of times" and "drawing" not in name]


@pytest.mark.parametrize(("of", "name"), HEADED)
@given(seed=strategies.integers(0, 2**32 - 1))
@examples(5)
def test_the_order_of_columns_does_not_matter(of, name, seed, tmp_path_factory):
    row = dict(TABLES[of][name])
    rows = list(csv.reader(io.StringIO(row["text"]), skipinitialspace=True))
    order = np.random.default_rng(seed).permutation(len(rows[0]))
    text = "".join(",".join(line[i] for i in order) + "\n" for line in rows)
    angles = row.get("body") and "qw" not in text and "w" not in rows[0][0]
    frame = "body" if angles else row.pop("frame", "optical")
    path = write(tmp_path_factory.mktemp("order"), text)
    CHECKS[of](read(of, path, **row | {"frame": frame}), row)


WORDLESS = ("tum", "rtabmap", "ros2 topic echo of a pose")


def test_every_word_for_columns_has_a_file():
    told = {(of, str(row["columns"])) for of, name in ALL if "columns" in (row := TABLES[of][name])}
    assert {layout[1::-1] for layout in LAYOUTS} <= told | {(POSES, name.split()[0]) for name in WORDLESS} | {
        (TAGS, "wpilib")
    }


@pytest.mark.parametrize("name", WORDLESS)
def test_formats_without_a_word_take_theirs(name, tmp_path):
    row = TABLES["poses"][name]
    values = re.sub(r"^#.*\n", "", row["text"])
    check_poses(read("poses", write(tmp_path, values), **row | {"columns": name.split()[0]}), row)


def test_names_of_a_file_come_before_columns(tmp_path):
    row = TABLES["poses"]["navvis"]
    with_header = row["text"].lstrip("#")
    check_poses(read("poses", write(tmp_path, with_header), **row | {"columns": "tum"}), row)
    unknown = "a,b,c,d,e,f,g,h\n" + TABLES["poses"]["euroc without a header"]["text"]
    row = TABLES["poses"]["euroc without a header"]
    check_poses(read("poses", write(tmp_path, unknown), **row), row)


@pytest.mark.parametrize("unit", ["mm", "cm", "in", "ft", "meters"])
def test_places_are_read_in_every_unit(unit, tmp_path):
    size = VOCABULARY[POSES][2].units[unit]
    header = f"id,x_{unit},y [{unit}],z ({unit}),qx,qy,qz,qw\n"
    half = 0.5**0.5
    text = header + f"7,{2 / size!r},0,{1.2 / size!r},{half},0,0,{half}\n"
    check_tags(read("tags", write(tmp_path, text)), {})


def test_repeated_times_are_left_out_with_a_note(tmp_path):
    first, *rest = TABLES["poses"]["tum"]["text"].splitlines()
    file = TrajectoryFile(str(write(tmp_path, "\n".join([first, first, *rest]))))
    check_poses(file.trajectory, TABLES["poses"]["tum"])
    assert file.note.startswith(
        f"1 of 4 rows of {tmp_path / 'file'} repeat the time of the row before, at most 0 mm away (first in line 2)"
    )


def test_angles_of_a_camera_are_about_its_axis(tmp_path):
    header, rows = "time,x,y,z,{}\n", "0,1,1,1,0.3,0.1\n1,1,1,1,0.4,0.2\n"
    found = [
        read("poses", write(tmp_path, header.format(names) + rows)) for names in ("yaw_from_y,pitch_up", "yaw,pitch")
    ]
    for one in found:
        np.testing.assert_allclose(
            one.poses[0, :3, 2], [np.sin(0.3) * np.cos(0.1), np.cos(0.3) * np.cos(0.1), np.sin(0.1)]
        )


def test_tags_come_back_from_a_file(tmp_path):
    for row in (row for row in TABLES["tags"].values() if "up" not in row):
        read("tags", write(tmp_path, row["text"]), **row).to_csv(tmp_path / "again.csv")
        check_tags(read("tags", tmp_path / "again.csv"), row)
