"""Formats of other packages are read like those of `lmd`, and the documentation lists ours."""

import json
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType

import pytest

from lmd.core.checks import InputError
from lmd.formats import registry
from lmd.formats.calibrations import calibrated_camera
from lmd.formats.registry import FAMILIES, Format, has_keys

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "benchmarks"))
import format_tables  # noqa: E402

ROS = {
    "image_width": 640,
    "image_height": 480,
    "camera_matrix": {"data": [300.0, 0.0, 320.0, 0.0, 310.0, 240.0, 0.0, 0.0, 1.0]},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"data": [0.1, 0.0, 0.0, 0.0, 0.0]},
}
READ = Format("calibration", "acme", has_keys("acme"), lambda file: {"": file.keys["acme"]})
REFUSED = Format("calibration", "old acme", has_keys("acme_1"), why_not="it is of acme 1: convert it by acme-upgrade")
COLMAP = "1 PINHOLE 640 480 300.0 310.0 320.5 240.5\n"


@pytest.fixture
def others(monkeypatch):
    """A function that installs an entry point with a value."""
    monkeypatch.setattr(registry, "outside", registry.outside.__wrapped__)

    def install(value):
        acme = ModuleType("acme")
        acme.FORMATS = value
        monkeypatch.setitem(sys.modules, "acme", acme)
        entry = EntryPoint("acme", "acme:FORMATS", "lmd.formats")
        monkeypatch.setattr(registry, "entry_points", lambda group: [entry] if group == "lmd.formats" else [])

    return install


@pytest.mark.parametrize("value", [READ, [REFUSED, READ]], ids=["a format", "a list"])
def test_a_format_of_another_package_is_read_like_ours(others, write, value):
    with pytest.raises(InputError, match="no calibration that is known here"):
        calibrated_camera(write(json.dumps({"acme": ROS})))
    others(value)
    assert calibrated_camera(write(json.dumps({"acme": ROS}))) == calibrated_camera(write(json.dumps(ROS)))


def test_a_format_of_another_package_is_tried_before_ours(others, write):
    others(READ)
    keys = ROS | {"acme": ROS | {"image_width": 800}}
    assert calibrated_camera(write(json.dumps(keys))) == calibrated_camera(write(json.dumps(keys["acme"])))


def test_a_format_of_keys_leaves_texts_without_keys_to_ours(others, write):
    ours = calibrated_camera(write(COLMAP))
    others([READ, REFUSED])
    assert calibrated_camera(write(COLMAP)) == ours


def test_a_format_that_is_recognised_and_refused_gives_its_sentence(others, write):
    others([READ, REFUSED])
    with pytest.raises(InputError, match=r": it is of acme 1: convert it by acme-upgrade\.$"):
        calibrated_camera(write(json.dumps({"acme_1": 0, **ROS})))
    with pytest.raises(InputError, match="it is a scene of OpenMVG"):
        calibrated_camera(write(json.dumps({"sfm_data_version": "0.3"})))


def test_an_entry_point_that_holds_no_format_is_named(others, write):
    others(["calibration"])
    with pytest.raises(InputError, match=r"acme:FORMATS of lmd\.formats must be a Format or a list of them"):
        calibrated_camera(write(json.dumps(ROS)))


def test_an_entry_point_that_cannot_be_loaded_is_named(others, write):
    others(READ)
    del sys.modules["acme"].FORMATS
    with pytest.raises(InputError, match=r"acme:FORMATS of lmd\.formats cannot be loaded"):
        calibrated_camera(write(json.dumps(ROS)))


def test_a_format_has_a_family_that_is_known():
    with pytest.raises(InputError, match=r"family must be one of calibration, trajectory, .*, got 'soup'"):
        Format("soup", "acme", has_keys("acme"))


@pytest.mark.parametrize("family", FAMILIES)
def test_the_formats_of_a_family_are_read_or_refused(family):
    for form in registry.formats(family):
        assert form.family == family
        assert form.read is None or not form.why_not


def test_the_documentation_lists_the_formats():
    """`python benchmarks/format_tables.py --update docs/*.md` writes the pages."""
    pages = [path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs").glob("*.md"))]
    for page in pages:
        assert format_tables.updated(page) == page
    for family in FAMILIES:
        assert sum(format_tables.table(family) in page for page in pages) == 1
