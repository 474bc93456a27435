import ctypes
import importlib

import numpy as np
import pytest
from support.processes import ROOT
from support.tables import rows

from lmd.scene.families import FAMILIES, dictionary, family_named, picture
from lmd.scene.tag import Tag

OF_OPENCV = [name for name, family in FAMILIES.items() if family.dictionary]
OF_APRILTAG = [name for name, family in FAMILIES.items() if family.apriltag]


@pytest.mark.parametrize("name", OF_OPENCV)
def test_the_table_of_families_is_that_of_opencv(name):
    assert dictionary(name).markerSize + 2 == FAMILIES[name].modules
    assert len(dictionary(name).bytesList) == FAMILIES[name].ids


@pytest.mark.parametrize("name", OF_APRILTAG)
def test_pictures_and_the_table_are_those_of_the_apriltag_library(name):
    pyapriltags = pytest.importorskip("pyapriltags")
    from pyapriltags.apriltags import _ImageU8

    library, family = pyapriltags.Detector(families="").libc, FAMILIES[name]
    described = getattr(library, f"{family.apriltag}_create")()
    known = described.contents
    assert (known.ncodes, known.width_at_border) == (family.ids, family.modules)
    library.apriltag_to_image.restype = ctypes.POINTER(_ImageU8)
    for number in (0, 7, family.ids - 1):
        image = library.apriltag_to_image(described, number).contents
        rows = np.ctypeslib.as_array(image.buf, (image.height, image.stride))[:, : image.width] > 0
        margin = (len(rows) - family.picture_modules) // 2
        theirs = rows[margin : len(rows) - margin, margin : len(rows) - margin]
        ours = picture(name, number)
        if name.startswith("circle"):  # outside of the circle is paper, where the library leaves black
            data = np.zeros_like(ours)
            data[1:-1, 1:-1] = data[[0, -1], 3:6] = data[3:6][:, [0, -1]] = True
            data[3:6, 0] = data[3:6, -1] = True
            assert ours[~data].all()
            ours, theirs = ours[data], theirs[data]
        assert (ours == theirs).all()


def test_an_apriltag_hangs_as_in_apriltags_own_picture():
    # The first row inside the border of its tag 0; OpenCV has it, backwards, as the last.
    assert "".join(".#"[not white] for white in picture("36h11", 0)[1]) == "#..#.#.#"


@pytest.mark.parametrize(("name", "family"), rows(__file__, "names of families"))
def test_a_family_has_names_in_many_libraries(name, family):
    assert family_named(name) == family
    if family in FAMILIES:
        assert Tag(0.1, name) == Tag(0.1, family)


@pytest.mark.parametrize("name", FAMILIES)
def test_the_words_of_the_edge_are_those_of_the_detected_square(name):
    """Around the corners that AprilTag and OpenCV detect, a black square is black within, and white if it is not."""
    within, named = picture(name, 0), FAMILIES[name]
    inner = within[named.around : -named.around, named.around : -named.around] if named.around else within
    border = np.concatenate([inner[0], inner[-1], inner[:, 0], inner[:, -1]])
    assert set(border) == {named.square.startswith("white")}
    docs = (ROOT / "docs" / "detectors.md").read_text()
    listed = "4x4_50" if "x" in name else name  # one row for 4x4_50 to 7x7_1000
    (row,) = [row for row in docs.splitlines() if row.startswith("| `") and f"`{listed}`" in row.split("|")[1]]
    assert row.endswith(f"| of the {named.square} |")


def test_the_drawing_of_edges_is_that_of_its_command(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    edges = importlib.import_module("edges")
    edges.main(tmp_path / "edges.svg")
    assert (tmp_path / "edges.svg").read_bytes() == edges.FILE.read_bytes()
