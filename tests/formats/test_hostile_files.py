"""Small files that would take hours or gigabytes: each is refused in one sentence before the work."""

import json
import re
import signal
from contextlib import contextmanager
from pathlib import Path

import ezdxf
import pytest
import yaml
from support.format_samples import READERS, SAMPLES, content, texts
from support.rooms import KEYS

from lmd.core.checks import InputError

LONG, SECONDS = 100_000, 10.0  # characters, and processor time that quadratic work exceeds many times
RUNS = yaml.safe_load(Path(__file__).with_name("files").joinpath("refused.yaml").read_text(encoding="utf-8"))["long"]


# Contents of a file after a damage.
DAMAGES = {
    "empty": lambda _: b"",
    "no text": lambda whole: whole[:1] + b"\x00\xff\xfe" + whole[1:],
    "cut": lambda whole: whole[: len(whole) // 3],
    "NaN": lambda whole: re.sub(rb"(?<![\w.])-?\d+\.?\d*(?![\w.])", b"NaN", whole),
}
ALL = SAMPLES | {"trajectory": texts("poses"), "detections": texts("detections")}
ALL["tag map"] = SAMPLES["tag map"] | texts("tags")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize(("family", "name"), [(family, name) for family, own in ALL.items() for name in own])
def test_a_damaged_file_is_refused_in_one_sentence(family, name, damage, tmp_path):
    whole, path, message = content(ALL[family][name]), tmp_path / name, ""
    path.write_bytes(damaged := DAMAGES[damage](whole))
    try:
        READERS[family](path)
    except InputError as error:
        message = str(error)
    assert message or damage == "cut" or damaged == whole  # lines may be whole
    assert "\n" not in message
    assert "object" not in message  # no words of Python's


@contextmanager
def hang_guard():
    """Raise `TimeoutError` after `SECONDS` of processor time."""

    def stop(*_):
        raise TimeoutError

    before = signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)


def refused(family, path, words=""):
    with hang_guard(), pytest.raises(InputError) as error:
        READERS[family](path)
    assert words in str(error.value)
    assert path.name in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("family", RUNS["heads"])
def test_long_runs_of_characters_take_linear_time(family, tmp_path):
    path = tmp_path / "file"
    for head in RUNS["heads"][family]:
        for unit in (*RUNS["units"], *RUNS["texts"][family], "1 " + "1" * 999 + " "):
            path.write_text(head + unit * (LONG // len(unit)) + "!")
            refused(family, path)


@pytest.mark.parametrize("length", [30, LONG])
def test_comments_before_a_tag_map_take_linear_time(length, tmp_path):
    (path := tmp_path / "file").write_text("/**/" * length + "x")
    refused("tag map", path)


def nested(drawing, times):
    for i in range(10):
        block = drawing.blocks.new(f"b{i}")
        for _ in range(times):
            block.add_blockref(f"b{i + 1}", (0, 0))


def itself(drawing):
    for into in (drawing.blocks.new("s"), drawing.modelspace()):
        into.add_blockref("s", (0, 0))


DRAWINGS = {
    "circle": (lambda d: d.modelspace().add_circle((0, 0), 1e14), "1e+14 units from the origin"),
    "large circle": (lambda d: d.modelspace().add_circle((0, 0), 1e10), "tolerances along a shape; at most"),
    "circles": (lambda d: [d.modelspace().add_circle((0, 0), 1e6 + i) for i in range(50)], "5001 vertices of shapes"),
    "blocks": (lambda d: (nested(d, 10), d.modelspace().add_blockref("b0", (0, 0))), "5001 entities"),
    "itself": (itself, "33 nested blocks; at most 32"),
    "far": (lambda d: d.modelspace().add_line((-1e308, 0), (1e308, 1e308)), "1e+308 units from the origin"),
}


@pytest.mark.parametrize("name", DRAWINGS)
def test_a_drawing_that_grows_is_refused(name, tmp_path, monkeypatch):
    monkeypatch.setattr("lmd.formats.dxf.MOST_ENTITIES", 5_000)
    monkeypatch.setattr("lmd.formats.dxf.MOST_VERTICES", 5_000)
    drawing = ezdxf.new(units=6)
    drawing.modelspace().add_lwpolyline([(0, 0), (5, 0), (5, 4), (0, 4)], close=True)
    build, words = DRAWINGS[name]
    build(drawing)
    drawing.saveas(path := tmp_path / "plan.dxf")
    refused("floor plan", path, words)


@pytest.mark.parametrize(
    ("name", "content"),
    [("e.png", b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n"), ("m.pgm", b"P5 7700 7700 255\n")],
)
def test_a_picture_of_another_kind_or_size_is_not_opened(name, content, tmp_path):
    (tmp_path / name).write_bytes(content)
    (path := tmp_path / "map.yaml").write_text(json.dumps(KEYS | {"image": name}))
    refused("floor plan", path, "not PNG or PPM or BMP" if name == "e.png" else "59290000 cells; at most 36000000")


MESHES = {
    "n.gltf": ({"asset": {}, "nodes": [{}] * 50_001}, "50001 nodes; at most 50000"),
    "m.gltf": ({"asset": {}, "meshes": [{"primitives": [{}]}] * 50_001}, "50001 pieces of meshes"),
    "f.obj": ("v 0 0 0\n" + "f" + " 1" * 2001, "2001 corners in a face; at most 2000"),
    "o.obj": ("usemtl a\n" * 30_001, "30001 names of objects and materials"),
}


@pytest.mark.parametrize("name", MESHES)
def test_a_mesh_of_too_many_parts_is_refused(name, tmp_path):
    content, words = MESHES[name]
    (path := tmp_path / name).write_text(content if isinstance(content, str) else json.dumps(content))
    refused("room", path, words)
