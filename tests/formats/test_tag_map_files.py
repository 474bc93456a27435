"""Maps of others, in the forms in which they come, against what their makers say of them."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lmd.core.checks import InputError
from lmd.formats.tag_maps import FileDeployment, read_deployment
from lmd.space.cuboid import Cuboid

WPILIB = Path(__file__).with_name("files").joinpath("tag_map", "wpilib.json").read_text(encoding="utf-8")
REAL = Path(__file__).parents[2] / "../shared/real/layouts"


@pytest.fixture
def read(tmp_path):
    def read_text(text):
        (tmp_path / "map").write_text(text if isinstance(text, str) else json.dumps(text))
        return read_deployment(tmp_path / "map")

    return read_text


def test_comments_in_a_file_of_wpilib_are_left_out(read):
    commented = WPILIB.replace('"tags"', '/* all of them */ "tags"').replace("}}}]", "}}},]")
    assert commented.count("*/") == commented.count(",]") == 1
    found = read(f"// mine: http://here\n{commented}")
    assert found.ids.tolist() == [4]
    assert_allclose([*found.positions, *found.normals, *found.ups], [[1, 1, 0.5], [1, 0, 0], [0, 0, 1]], atol=1e-9)


def test_a_field_of_limelight_says_from_where_its_places_are_counted(read):
    tag = {"id": 1, "size": 165.1, "transform": np.eye(4).ravel().tolist()}
    found = read({"fiducials": [tag], "fieldlength": 16.0, "fieldwidth": 8.0})
    assert_allclose(found.positions, [[8, 4, 0]])
    assert "places are counted from the corner of its field" in found.note
    assert not read({"fiducials": [tag]}).note


def test_a_map_is_a_deployment_beside_the_walls_of_a_room(tmp_path):
    (tmp_path / "layout.json").write_text(WPILIB.replace('"W": 1', '"W": 0').replace('"Z": 0', '"Z": 1'))
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
