"""The project grows no heavier, and its prose does not fall back: `python benchmarks/weight.py` prints the amounts."""

import sys

import pytest
from support.processes import ROOT

sys.path.append(str(ROOT / "benchmarks"))
import weight

# What the project may weigh. What a change adds it pays by what it takes out; lower a number when you have lowered the
# amount, and raise none.
BUDGET = {
    "files of lmd": 297,
    "code lines of lmd": 28564,
    "files of pipelines": 48,
    "code lines of pipelines": 3400,
    "code lines of tests": 20431,
    "files of conf": 100,
    "keys of conf": 376,
    "words of docs": 40839,
    "commands": 12,
}
# Docstrings and comments with each phrase, at most. Lower a number when you have lowered the count.
CEILINGS = {
    "docstring begins with What, How, Whether, Where, Who or Which": 0,
    "so many, so far, so much": 0,
    "the same, without a noun": 1,
    "nobody, whoever, whatever": 0,
    "what it is of": 0,
}
MODULE = '''"""What it is.

The whole is so far from done.
"""

import math


def area(radius):
    """Area of a circle."""
    return math.pi * (
        radius**2  # the same as before, whoever asks
    )
'''


@pytest.fixture(scope="module")
def sources():
    return weight.modules(ROOT, weight.SOURCES)


def test_nothing_exceeds_its_budget():
    found = weight.amounts(ROOT)
    over = {name: f"{found[name]} > {BUDGET[name]}" for name in BUDGET if found[name] > BUDGET[name]}
    assert over == {}, "take something out, or give the reason why the budget is wrong"
    assert set(found) == set(BUDGET)


def test_the_page_has_the_packages_and_is_written_by_its_command():
    page = (ROOT / weight.PAGE).read_text()
    assert page.startswith(weight.HEADING)
    for name in (*BUDGET, *{module.package for module in weight.modules(ROOT, weight.SOURCES)}):
        assert f"| {name} |" in page


def test_amounts_are_counted(tmp_path):
    files = {
        "lmd/circle.py": MODULE,
        "pipelines/run.py": "import lmd\n\nlmd.run(\n    1,\n)\n",
        "tests/test_run.py": "def test():\n    assert True\n",
        "conf/run.yaml": "defaults: [base]\n_target_: a.B\nroom:\n  size: [1, 2]\n  height: 3\nhydra: {job: x}\n",
        "conf/room/none.yaml": "",
        "docs/api/page.md": "Two words.\n\n| a | b |\n",
        "pyproject.toml": '[project.scripts]\nlmd-run = "pipelines.run:main"\n',
    }
    for path, text in files.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    assert list(weight.amounts(tmp_path).values()) == [1, 4, 1, 3, 2, 2, 2, 7, 1]
    assert list(weight.amounts(tmp_path)) == list(BUDGET)


def test_no_phrase_that_the_style_forbids_grows(sources):
    found = weight.tics(sources)
    assert {phrase: found[phrase] for phrase in CEILINGS if found[phrase] > CEILINGS[phrase]} == {}
    assert set(found) == set(CEILINGS)


def test_lines_and_phrases_are_counted(tmp_path):
    (tmp_path / "lmd").mkdir()
    (tmp_path / "lmd" / "circle.py").write_text(MODULE)
    (module,) = weight.modules(tmp_path, ("lmd",))
    assert weight.code_lines(module) == 4
    assert list(weight.tics([module]).values()) == [1, 1, 1, 1, 0]


def test_modules_with_one_importer_and_names_with_two_meanings_are_found(tmp_path):
    files = {
        "a/x.py": "from lmd.a.y import area\n",
        "a/y.py": "def area(): ...\n",
        "b/x.py": "class area: ...\n",
    }
    for path, text in files.items():
        (tmp_path / "lmd" / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "lmd" / path).write_text(text)
    sources = weight.modules(tmp_path, ("lmd",))
    assert weight.single_importers(sources) == [("lmd.a.y", "lmd.a.x")]
    assert weight.double_names(sources) == ({"x": ["lmd.a", "lmd.b"]}, {"area": ["lmd.a.y", "lmd.b.x"]})
