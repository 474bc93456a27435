"""The programs of docs/suite.md run as they stand."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "suite.md").read_text(encoding="utf-8")
PROGRAMS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.thorough("docs/suite.md", "lmd/suite")  # 10 s, most of it imports of the libraries
@pytest.mark.parametrize("program", PROGRAMS, ids=range(len(PROGRAMS)))
def test_a_program_of_the_page_runs(program, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(program, {})


def test_the_page_counts_the_problems():
    from lmd.suite import names

    assert f"{len(names())} frozen problems" in PAGE


def test_the_entry_of_the_page_is_scored(tmp_path):
    from lmd.suite import best, document, verify

    (entry,) = re.findall(r"```yaml\n(problem: .*?)```", PAGE, re.DOTALL)
    (tmp_path / "mine.yaml").write_text(entry)
    best("tiny_mean")[0].to_csv(tmp_path / "mine.csv")
    assert verify(tmp_path / "mine.yaml")["value"] == pytest.approx(document("tiny_mean").best["value"], abs=1e-12)
