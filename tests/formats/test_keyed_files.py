"""Keyed files of all formats: a table of values, a table of refusals, and properties of every row.

A format is tested by a file in `files/calibration` or `files/tag_map` and its line in the table beside the folder.
"""

import json
import random
import re
from pathlib import Path

import pytest
import yaml
from numpy.testing import assert_allclose

from lmd.core.checks import InputError
from lmd.core.files import parse_keys
from lmd.formats import registry
from lmd.formats.calibrations import CalibrationFile, read_calibration
from lmd.formats.tag_maps import TagMapFile, read_deployment

FILES = Path(__file__).with_name("files")
USUAL = {"size": [640, 480], "focal": [600.0, 610.0], "centre": [320.0, 240.0], "lens_model": "plumb_bob"}
USUAL |= {"lens": [-0.2, 0.05, 0.001, -0.002, 0.01]}
ARGUMENTS = ("name", "image_size", "distortion_model")


def table(name):
    return yaml.safe_load((FILES / name).read_text())


CALIBRATIONS, MAPS = table("calibrations.yaml"), table("tag_maps.yaml")
ALL = [("calibration", name) for name in CALIBRATIONS] + [("tag map", name) for name in MAPS]


def read(family, name, path):
    """Values of a file as in the tables."""
    if family == "calibration":
        options = {key: value for key, value in CALIBRATIONS.get(name, {}).items() if key in ARGUMENTS}
        found = read_calibration(path, **options)
        sizes = {"size": [found.image_width, found.image_height], "lens_model": found.distortion_model}
        return sizes | {"focal": found.focal_pixels, "centre": found.principal_point, "lens": found.distortion}
    found = read_deployment(path, family="36h11")
    found = {"id": found.ids, "position": found.positions, "normal": found.normals, "up": found.ups} | (
        {"edge": found.edges} if found.has_own_edges else {}
    )
    order = found["id"].argsort()  # of a mapping by ids, the keys' order is that of the tags
    return {key: value[order] for key, value in found.items()}


def assert_same(found, expected, tolerance):
    assert found.keys() == expected.keys()
    for key, value in expected.items():
        if isinstance(value, str):
            assert found[key] == value
        else:
            assert_allclose(found[key], value, atol=tolerance, err_msg=key)


def place(family, name):
    return FILES / family.replace(" ", "_") / name


@pytest.mark.parametrize(("family", "name"), ALL)
def test_a_file_has_the_values_of_the_table(family, name):
    row = CALIBRATIONS[name] if family == "calibration" else MAPS[name]
    expected = {key: value for key, value in row.items() if key not in ARGUMENTS}
    found = read(family, name, place(family, name))
    # Fitted coefficients hardly change the image, and differ by some 1e-8 from machine to machine.
    assert_same(found, USUAL | expected if family == "calibration" else expected, 1e-6)


def permuted(tree, rng):
    """A tree with the keys of all its mappings in another order."""
    if isinstance(tree, dict):
        keys = list(tree)
        rng.shuffle(keys)
        return {str(key): permuted(tree[key], rng) for key in keys}
    return [permuted(value, rng) for value in tree] if isinstance(tree, list) else tree


KEYED = [(family, name) for family, name in ALL if Path(name).suffix in (".json", ".yaml")]


@pytest.mark.parametrize(("family", "name"), KEYED)
def test_the_order_of_keys_does_not_matter(family, name, tmp_path):
    keys = parse_keys(name, place(family, name).read_text(), "path")
    (path := tmp_path / name).write_text(json.dumps(permuted(keys, random.Random(name))))
    assert_same(read(family, name, path), read(family, name, place(family, name)), 0.0)


@pytest.mark.parametrize(("family", "content", "words"), table("refused_keys.yaml"))
def test_what_is_not_read_is_refused_by_name(family, content, words, tmp_path):
    (path := tmp_path / "file").write_text(content)
    with pytest.raises(InputError) as told:
        read(family, "file", path)
    assert words in str(told.value) or re.search(words, str(told.value))


KINDS = {"calibration": CalibrationFile, "tag map": TagMapFile}


def test_every_row_that_reads_a_keyed_file_has_a_sample():
    found = {registry.format_of(family, KINDS[family](place(family, name))) for family, name in ALL}
    listed = {form for family in KINDS for form in registry.formats(family) if form.read}
    others = {"bag of ROS 2", "a list of tags", "table"}  # `test_bags.py` and `test_tag_tables.py` have those
    assert {form.name for form in listed} - {form.name for form in found} == others
