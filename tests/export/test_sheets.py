"""What comes out of the printer is what a real detector reads, at the right size."""

import math
import sys
from dataclasses import replace

import numpy as np
import pypdfium2
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.tables import rows
from support.thorough import examples

from lmd.detection.detectors import AprilTagDetector, ArucoDetector
from lmd.export.exports import not_printed
from lmd.export.paper import FOOTER, MARGIN, PAPERS, largest_whole, layout
from lmd.export.sheets import describe_sheets, write_sheets
from lmd.formats.tag_map import TagMap
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.families import FAMILIES
from lmd.scene.footprints import Footprints
from lmd.scene.labels import Labels
from lmd.scene.tag import Tag
from lmd.space.cuboid import Cuboid

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


@pytest.mark.parametrize(("tag", "paper", "count", "per_page"), rows(__file__, "sheets"))
def test_a_detector_reads_every_tag_upright_and_at_its_size(tag, paper, count, per_page, tmp_path):
    tag = Tag(**tag)
    sheets(tmp_path / "sheets.pdf", tag, count, paper, first=5)
    family, detectors = FAMILIES[tag.family], []
    detectors += [ArucoDetector(tag.family)] if family.dictionary else []
    detectors += [AprilTagDetector(tag.family)] if family.apriltag else []
    printed = list(pages(tmp_path / "sheets.pdf"))
    assert len(printed) == math.ceil(count / per_page)
    for detector in detectors:
        ids = []
        for picture, size in printed:
            assert sorted(size) == pytest.approx(PAPERS[paper], abs=0.01)
            found = detector.detect(picture)
            ids += found.ids.tolist()
            top_left, top_right, bottom_right, bottom_left = (MM * found.corners[:, i] for i in range(4))
            edge = 1000 * tag.size
            np.testing.assert_allclose(top_right - top_left, np.tile([edge, 0.0], (len(found), 1)), atol=0.25)
            np.testing.assert_allclose(bottom_left - top_left, np.tile([0.0, edge], (len(found), 1)), atol=0.25)
            np.testing.assert_allclose(bottom_right - bottom_left, np.tile([edge, 0.0], (len(found), 1)), atol=0.25)
            # The paper with its quiet zone is on the sheet, and white around the black square.
            margin, around = 500 * (tag.paper_edge - tag.picture_edge), 500 * (tag.picture_edge - tag.size)
            edge, top_left = 1000 * tag.picture_edge, top_left - around
            assert top_left.min() > 7.5
            assert top_left.min() - margin > -0.1
            inner = 0.5 * margin  # further out are labels and marks
            for x, y in top_left:
                left, above = (round((at - inner) / MM) for at in (x, y))
                around = np.full(2 * [round((edge + 2 * inner) / MM)], True)
                black = slice(round(inner / MM) - 2, round((inner + edge) / MM) + 2)
                around[black, black] = False
                assert (picture[above : above + len(around), left : left + len(around)][around] == 255).all()
        assert sorted(ids) == list(range(5, 5 + count))


def test_the_number_and_the_arrow_are_inside_of_the_cut(tmp_path):
    for tag, paper in ((Tag(0.1), "a4"), (Tag(0.1651), "a4"), (Tag(0.03), "letter")):
        deployment = sheets(tmp_path / "sheets.pdf", tag, 4, paper, first=171)
        cut = 0
        for page in pypdfium2.PdfDocument(tmp_path / "sheets.pdf"):
            picture = np.array(page.render(scale=DPI / 72, grayscale=True).to_pil())
            found, text, height = AprilTagDetector().detect(picture), page.get_textpage(), page.get_size()[1]
            for number, square in zip(found.ids.tolist(), MM * found.corners, strict=True):
                index, _ = text.search(str(number), match_whole_word=True).get_next()
                left, bottom, right, top = (at / 72 * 25.4 for at in text.get_charbox(index))
                margin = 500 * (tag.paper_edge - tag.size)
                low, high = square.min(axis=0) - margin, square.max(axis=0) + margin
                assert low[0] < left < right < high[0]
                assert low[1] < height / 72 * 25.4 - top < square[:, 1].min() - 0.5 * margin
                # Left of the number, and as high as it, is the arrow.
                rows = slice(round((height / 72 * 25.4 - top) / MM), round((height / 72 * 25.4 - bottom) / MM) + 1)
                columns = slice(round(max(low[0], 0.0) / MM) + 2, round(left / MM) - 1)
                arrow = picture[rows, columns] < 128
                width = arrow.sum(axis=1)
                assert width[-3] > 2 * width[2]  # it points up
                cut += 1
        assert cut == len(deployment.ids)


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


@pytest.mark.parametrize("family", ["36h11", "4x4_50", "41h12"])
@pytest.mark.parametrize("paper", PAPERS)
def test_the_largest_edge_on_a_sheet_is_the_last_that_is_not_cut(family, paper):
    edge = largest_whole(Tag(0.1, family), paper)
    assert sorted(layout(Tag(edge, family), paper).page) == sorted(PAPERS[paper])
    page = layout(Tag(edge + 2e-5, family), paper).page
    assert min(page) > min(PAPERS[paper])


def test_maps_do_not_wait_for_a_package_that_prints(monkeypatch):
    monkeypatch.setitem(sys.modules, "reportlab", None)
    reasons = not_printed()
    assert list(reasons) == ["plan", "sheets"]
    assert all("this needs the package reportlab" in reason for reason in reasons.values())


@examples(100)
@given(
    edge=st.floats(0.01, 0.8),
    family=st.sampled_from(["36h11", "16h5", "4x4_50", "52h13"]),
    quiet_zone=st.floats(0.0, 3.0),
    paper=st.sampled_from(list(PAPERS)),
)
def test_what_is_black_is_where_printers_print(edge, family, quiet_zone, paper):
    tag = Tag(edge, family, quiet_zone)
    sheets, plate, black = layout(tag, paper), 1000 * tag.paper_edge, 1000 * tag.picture_edge
    width, height = sheets.page
    assert (sorted(sheets.page) == sorted(PAPERS[paper])) == (edge <= largest_whole(tag, paper) + 1e-9)
    right, bottom = sheets.left + sheets.columns * plate, sheets.top - sheets.rows * sheets.pitch
    margin = (plate - black) / 2
    assert sheets.per_sheet > 0
    assert sheets.pitch >= plate
    assert min(sheets.left, width - right, height - sheets.top) > -1e-6
    assert min(sheets.left + margin, width - right + margin) > MARGIN - 1e-6
    assert bottom > MARGIN + FOOTER - 1e-6


def test_sheets_are_described_by_how_many_there_are():
    def described(tag, count):
        drawn = UniformDeployment(count).draw(ROOM, np.random.default_rng(0), tag)
        return describe_sheets(TagMap(ROOM, tag, drawn), "a4")

    assert described(Tag(0.1), 40) == "20 of a4, 2 to a sheet"
    large = "2 of 391 x 398 mm: a tag is larger than a4;"
    assert described(Tag(0.3), 2).startswith(large)
    assert described(Tag(0.1, edges=(0.3, 0.1)), 4).startswith(f"100 mm: 1 of a4, 2 to a sheet; 300 mm: {large}")


def test_each_size_has_its_own_sheets(tmp_path):
    tag = Tag(0.1, edges=(0.06, 0.3, 0.1))
    deployment = UniformDeployment(6).draw(ROOM, np.random.default_rng(0), tag)
    write_sheets(tmp_path / "sheets.pdf", TagMap(ROOM, tag, deployment), "a4")
    printed, read = [picture for picture, _ in pages(tmp_path / "sheets.pdf")], {}
    assert len(printed) == 1 + 1 + 2  # small ones, middle ones, and large ones on pages of their own
    for picture in printed:
        found = AprilTagDetector().detect(picture)
        sides = np.linalg.norm(found.corners - np.roll(found.corners, 1, axis=1), axis=-1)
        read |= dict(zip(found.ids.tolist(), MM * sides, strict=True))
    assert sorted(read) == list(range(6))
    for number, sides in read.items():
        np.testing.assert_allclose(sides, 1000 * deployment.edges[number], atol=0.25)
    texts = [page.get_textpage().get_text_range() for page in pypdfium2.PdfDocument(tmp_path / "sheets.pdf")]
    assert all("black square 300 mm" in text for text in texts[2:])


def test_the_same_sheets_are_the_same_bytes(tmp_path):
    room = Footprints(ROOM, Tag(0.1, quiet_zone=0.0))
    deployment = room.draw(RandomDeployment(5), np.random.default_rng(0))
    for name in ("one", "two"):
        write_sheets(tmp_path / name, TagMap(ROOM, Tag(0.08), deployment), "a4")
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
