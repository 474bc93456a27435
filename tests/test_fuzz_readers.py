"""Broken files end in a sentence: bits, types, sizes and nesting of a small sample of each kind are changed.

A format is added by a file of `format_samples`, another reader by a line of `CASES`: a name, a function of a
path, the name of the file, and a text that it reads.
"""

import json
import random
from functools import partial

import pytest
from support.format_samples import READERS, SAMPLES, content
from support.thorough import SHARE

from lmd.core.checks import InputError
from lmd.formats.rigs import read_mount
from lmd.scene.pdf import from_csv as read_pdf
from lmd.survey.knowledge import Boards, MeasuredPoints

BROKEN = round(100 * SHARE)  # files of each kind of change
VALUES = [
    *(None, True, "", "x", "nan", -1, 0, 1.5, 1e308, -(10**400), 10**19, [], {}, [[]], [1, 2], {"x": {}}, "\u2028\x00")
]
TOKENS = [*',;|#\n\x00é"[{:', "", "x", "nan", "inf", "-1", "1e400", "9" * 400, "0.5.5"]
CHAIN = {"cam0": {"T_cam_imu": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}}
CASES = {
    **{f"{family} {name}": (READERS[family], name, t) for family, own in SAMPLES.items() for name, t in own.items()},
    "mount": (read_mount, "mount", json.dumps(CHAIN)),
    "points": (MeasuredPoints.from_csv, "points", "id,x,y,z\n1,0,0,0\n2,1,0,0\n3,0,1,0\n"),
    "boards": (partial(Boards.from_csv, printed=1e-3), "boards", "board,id,x,y\na,1,0,0\na,2,0.1,0\n"),
    "pdf": (lambda path: read_pdf(str(path)), "pdf", "weight,pitch,yaw\n0.25,0.1,1\n0.75,-0.1,2\n"),
}


def places(tree, path=()):
    """Where all values of a tree are."""
    yield path
    inner = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in inner:
        yield from places(value, (*path, key))


def changed(tree, rng):
    """A tree with a value that is another one, is missing, is nested deeply or is there a hundred times."""
    tree = json.loads(json.dumps(tree))
    path = rng.choice([place for place in places(tree) if place])
    above = tree
    for key in path[:-1]:
        above = above[key]
    kind = rng.randrange(5)
    if kind == 0:
        del above[path[-1]]
    elif kind == 1:
        for _ in range(rng.choice([3, 60])):
            above[path[-1]] = [above[path[-1]]] if rng.random() < 0.5 else {"x": above[path[-1]]}
    elif kind == 2 and isinstance(above[path[-1]], list):
        above[path[-1]] *= rng.choice([2, 100])
    else:
        above[path[-1]] = rng.choice(VALUES)
    return tree


def broken_bytes(data, rng):
    """Bytes with a changed bit."""
    changed_data = bytearray(data)
    changed_data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(changed_data)


def broken(text, rng):
    """A file of a text or bytes as bytes, with a change."""
    try:
        text = text if isinstance(text, str) else text.decode()
    except UnicodeDecodeError:
        return broken_bytes(text, rng)
    if text.startswith('{"') and rng.random() < 0.6:
        return json.dumps(changed(json.loads(text), rng)).encode()
    kind, place = rng.randrange(4), rng.randrange(len(text))
    if kind == 0:
        return broken_bytes(text.encode(), rng)
    if kind == 1:
        return (text[:place] + text[place + rng.randrange(20) :]).encode()
    if kind == 2:
        return (text[:place] + rng.choice(TOKENS) + text[place + rng.randrange(3) :]).encode()
    return (text[:place] + text[rng.randrange(len(text)) :] * rng.choice([1, 5])).encode()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", CASES)
def test_a_broken_file_is_read_or_refused_in_a_sentence(name, tmp_path):
    read, file, text = CASES[name]
    path = tmp_path / file
    path.write_bytes(content(text))
    read(path)
    rng = random.Random(name)
    for _ in range(BROKEN):
        path.write_bytes(changed_file := broken(text, rng))
        try:
            read(path)
        except InputError:
            pass
        except Exception as error:
            pytest.fail(f"{type(error).__name__}: {error}\nof {changed_file!r}")
