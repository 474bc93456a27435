"""Synonyms in files of other programs, and words that change the meaning of values."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lmd.core.checks import InputError
from lmd.formats.calibrations import calibrated_camera
from lmd.formats.placed_tag import tag_named
from lmd.formats.tag_maps import read_deployment


@pytest.fixture
def write(tmp_path):
    def written(text, name="file.csv"):
        (tmp_path / name).write_text(text)
        return str(tmp_path / name)

    return written


@pytest.mark.parametrize(
    ("family", "names"),
    [
        ("36h11", "tag36h11:7 tag36h11_00007 36h11-7 map/tag36h11:7 Apriltag36_11_00007 DICT_APRILTAG_36H11_7"),
        ("41h12", "tagStandard41h12:7"),
        ("48h12", "tagCustom48h12:7"),  # not known here, which a map of tags is told
        ("4x4_50", "DICT_4X4_50:7 4x4_50_7"),
        ("aruco_original", "aruco_original_7"),
        ("aruco_mip_36h12", "ARUCO_MIP_36h12_7"),
        ("unsure", "tag36h11 36h11 4x4_50 aruco_4x4_50 tag_16_5 tag_7_8 wall_7 door -7  None"),
        (None, "7 07 7.0 tag_7 tag-7 marker7 fiducial_7 ar_marker_7"),
    ],
)
def test_a_name_has_the_family_and_the_number_of_a_tag(family, names):
    assert {tag_named(name) for name in names.split(" ")} == {None if family == "unsure" else (family, 7)}
    assert tag_named("tag_3611") == (None, 3611)


@pytest.mark.parametrize("model", ["ftheta", "division", "Inverse Brown Conrady"])
def test_a_model_that_is_not_known_is_refused_wherever_it_stands(write, model):
    lens = {"K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]], "D": [0.1, 0, 0, 0, 0], "model": model}
    for keys in (lens | {"image_size": [640, 480]}, lens | {"width": 640, "height": 480}):
        with pytest.raises(InputError, match="is not known here"):
            calibrated_camera(write(json.dumps(keys), "camera.json"))


def test_a_fisheye_by_its_flag_is_one_beside_width_and_height(write):
    keys = {"K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]], "D": [0.1, 0, 0, 0], "width": 640, "height": 480}
    camera = calibrated_camera(write(json.dumps(keys | {"fisheye": True}), "camera.json"))
    assert camera.lens.model == "equidistant"


def test_limelights_field_says_from_where_its_places_are_counted(write):
    tag = {"id": 1, "size": 165.1, "transform": np.eye(4).ravel().tolist()}
    found = read_deployment(write(json.dumps({"fiducials": [tag], "fieldlength": 16.0, "fieldwidth": 8.0}), "a.fmap"))
    assert_allclose(found.positions, [[8, 4, 0]])
    assert "places are counted from the corner of its field" in found.note
