"""What comes out of the printer is what a real detector reads, at the right size."""

import math
from dataclasses import replace

import numpy as np
import pypdfium2
import pytest

from lmd.checks import InputError
from lmd.deployment import RandomDeployment, UniformDeployment
from lmd.detection.detectors import AprilTagDetector, ArucoDetector
from lmd.export.formats import Export
from lmd.export.paper import PAPERS
from lmd.export.sheets import check_sheets, largest_paper, write_sheets
from lmd.export.tag_map import TagMap
from lmd.labels import Labels
from lmd.plates import Plates
from lmd.space.cuboid import Cuboid
from lmd.tag import Tag

ROOM = Cuboid((6.0, 4.0, 2.8), (5.0, 3.0, 1.2), 0.5)
DPI = 200
MM = 25.4 / DPI  # of a pixel


def sheets(path, tag, count, paper, first=0):
    source = UniformDeployment(count)
    deployment = replace(source.draw(ROOM, np.random.default_rng(0)), labels=Labels(np.arange(first, first + count)))
    write_sheets(path, TagMap(ROOM, tag, deployment), paper)
    return deployment


def pages(path):
    """Grey pictures of the pages, and their sizes in mm."""
    for page in pypdfium2.PdfDocument(path):
        yield (
            np.array(page.render(scale=DPI / 72, grayscale=True).to_pil()),
            [length / 72 * 25.4 for length in page.get_size()],
        )


@pytest.mark.parametrize(
    ("tag", "paper", "count", "per_page"),
    [
        (Tag(0.15), "a4", 3, 1),
        (Tag(0.06), "a4", 8, 6),
        (Tag(0.05), "letter", 14, 6),
        (Tag(0.04, "25h9"), "a4", 13, 12),
        (Tag(0.1, "4x4_50"), "a3", 7, 6),
    ],
)
def test_a_detector_reads_every_tag_upright_and_at_its_size(tag, paper, count, per_page, tmp_path):
    sheets(tmp_path / "sheets.pdf", tag, count, paper, first=5)
    detectors = [ArucoDetector(tag.family)] + ([] if "_" in tag.family else [AprilTagDetector(tag.family)])
    printed = list(pages(tmp_path / "sheets.pdf"))
    assert len(printed) == math.ceil(count / per_page)
    for detector in detectors:
        ids = []
        for picture, size in printed:
            assert size == pytest.approx(PAPERS[paper], abs=0.01)
            found = detector.detect(picture)
            ids += found.ids.tolist()
            top_left, top_right, bottom_right, bottom_left = (MM * found.corners[:, i] for i in range(4))
            edge = 1000 * tag.size
            np.testing.assert_allclose(top_right - top_left, np.tile([edge, 0.0], (len(found), 1)), atol=0.25)
            np.testing.assert_allclose(bottom_left - top_left, np.tile([0.0, edge], (len(found), 1)), atol=0.25)
            np.testing.assert_allclose(bottom_right - bottom_left, np.tile([edge, 0.0], (len(found), 1)), atol=0.25)
            # The paper with its quiet zone is on the sheet, and white up to the black square.
            margin = 500 * (tag.paper_edge - tag.size)
            assert top_left.min() - margin > 7.5
            for x, y in top_left:
                left, right, above, below = (round(at / MM) for at in (x - margin, x - 0.5, y - margin, y + edge))
                assert (picture[above + 2 : below, left + 2 : right] == 255).all()
        assert sorted(ids) == list(range(5, 5 + count))


def test_the_ruler_is_100_mm_long(tmp_path):
    sheets(tmp_path / "sheets.pdf", Tag(0.05), 1, "a4")
    ((picture, _),) = pages(tmp_path / "sheets.pdf")
    footer = picture[-round(30 / MM) :] < 128
    longest = max(footer, key=np.count_nonzero)
    dark = np.flatnonzero(longest)
    assert np.ptp(dark) * MM == pytest.approx(100.0, abs=0.3)
    assert len(dark) > 0.99 * np.ptp(dark)


def test_labels_name_tag_and_surface(tmp_path):
    deployment = sheets(tmp_path / "sheets.pdf", Tag(0.15), 6, "a4")
    texts = [page.get_textpage().get_text_range() for page in pypdfium2.PdfDocument(tmp_path / "sheets.pdf")]
    names = [ROOM.surfaces()[index].name for index in deployment.surfaces]
    assert len(texts) == 6
    for number, name in zip(deployment.ids, names, strict=True):
        (text,) = [text for text in texts if name in text]
        assert f"{number} {name}" in " ".join(text.split())
        assert "36h11: black square 150 mm, paper 187.5 mm" in text


def test_the_largest_tag_fits_and_a_larger_one_is_refused(tmp_path):
    for paper in PAPERS:
        edge = math.floor(largest_paper(paper) / 1.25) / 1000
        sheets(tmp_path / "sheets.pdf", Tag(edge), 1, paper)
        ((picture, _),) = pages(tmp_path / "sheets.pdf")
        assert AprilTagDetector().detect(picture).ids.tolist() == [0]
        with pytest.raises(InputError, match=rf"^edge = .* for a sheet of {paper}; .* {edge:g} m on {paper}"):
            check_sheets(Tag(edge + 0.001), paper)
    with pytest.raises(InputError, match=r"a4; what fits is 0\.155 m on a4, 0\.224 m on a3, 0\.159 m on letter\.$"):
        Export(["sheets"], "a4").check(Tag(0.2))
    Export(["sheets"], "a3").check(Tag(0.2))
    Export(["plan"], "a4").check(Tag(0.2))
    with pytest.raises(InputError, match=r"^paper must be one of a4, a3, letter, got 'a5'\.$"):
        Export(["sheets"], "a5")


def test_the_same_sheets_are_the_same_bytes(tmp_path):
    room = Plates(ROOM, 0.1)
    deployment = room.draw(RandomDeployment(5), np.random.default_rng(0))
    for name in ("one", "two"):
        write_sheets(tmp_path / name, TagMap(ROOM, Tag(0.08), deployment), "a4")
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
