"""Formats of other packages are read like those of `lmd`, and the documentation lists ours."""

import json
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType

import pytest
from support.tables import rows

from lmd.core.checks import InputError
from lmd.formats import registry
from lmd.formats.calibrations import read_calibration
from lmd.formats.registry import FAMILIES, Format

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "benchmarks"))
import format_tables  # noqa: E402

KEYS = {"pixels": [640, 480], "f": 600.0, "c": [320.0, 240.0], "k": [0.1, 0.0, 0.0, 0.0, 0.0]}
ROW = {"family": "calibration", "name": "acme", "marks": ["acme"], "each": "acme", "models": {"": "plumb_bob"}}
ROW |= {"at": {"size": "pixels", "f": "f", "cx": "c.0", "cy": "c.1", "lens": "k"}}
REFUSED = Format("calibration", "old acme", lambda file: "acme_1" in file.data, why_not="it is of acme 1: upgrade")
PRINTED = {"K": [300, 0, 320, 0, 310, 240, 0, 0, 1], "D": [0.1, 0, 0, 0, 0], "image_size": [640, 480]}
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


@pytest.mark.parametrize("value", [ROW, [REFUSED, ROW]], ids=["a row", "a list"])
def test_a_row_of_another_package_is_read_before_ours(others, write, value):
    path = write(json.dumps(PRINTED | {"acme": KEYS}))
    assert read_calibration(path).focal_pixels == (300.0, 310.0)
    others(value)
    found = read_calibration(path)
    assert (found.focal_pixels, found.principal_point, found.distortion[0]) == ((600.0, 600.0), (320.0, 240.0), 0.1)


@pytest.mark.parametrize(("change", "words"), rows(__file__, "changes of a row"))
def test_a_row_that_says_something_else_is_refused(change, words, write, monkeypatch, tmp_path):
    (tmp_path / "rows.yaml").write_text(json.dumps([ROW | change]))
    monkeypatch.setenv("LMD_FORMATS", str(tmp_path))
    monkeypatch.setattr(registry, "outside", registry.outside.__wrapped__)
    with pytest.raises(InputError, match=words):
        read_calibration(write(json.dumps({"acme": KEYS})))


def test_a_format_of_keys_leaves_texts_without_keys_to_ours(others, write):
    ours = read_calibration(write(COLMAP))
    others([ROW, REFUSED])
    assert read_calibration(write(COLMAP)) == ours


def test_a_format_that_is_recognised_and_refused_gives_its_sentence(others, write):
    others([ROW, REFUSED])
    with pytest.raises(InputError, match=r": it is of acme 1: upgrade\.$"):
        read_calibration(write(json.dumps({"acme_1": 0, **PRINTED})))
    with pytest.raises(InputError, match="it is a scene of OpenMVG"):
        read_calibration(write(json.dumps({"sfm_data_version": "0.3"})))


def test_an_entry_point_without_a_format_is_named(others, write):
    others(["calibration"])
    with pytest.raises(InputError, match=r"acme:FORMATS of lmd\.formats must be a Format, a row \(a mapping\)"):
        read_calibration(write(json.dumps(PRINTED)))
    del sys.modules["acme"].FORMATS
    with pytest.raises(InputError, match=r"acme:FORMATS of lmd\.formats cannot be loaded"):
        read_calibration(write(json.dumps(PRINTED)))


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
