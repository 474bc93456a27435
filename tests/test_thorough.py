from types import SimpleNamespace

import pytest
from support import thorough


def item(*paths, marked=True):
    marks = [pytest.mark.thorough(*paths).mark] if marked else []
    return SimpleNamespace(path=thorough.ROOT / "tests/pipelines/test_x.py", iter_markers=lambda _: marks)


def test_a_thorough_test_runs_when_it_is_asked_for():
    assert thorough.is_due(item(marked=False), "")
    assert not thorough.is_due(item("pipelines"), "")
    assert thorough.is_due(item("pipelines"), "all")


@pytest.mark.parametrize(
    ("changed", "due"),
    [
        ("pipelines/operations/sweeps/jobs.py", True),
        ("pipelines/operations_of_others.py", False),
        ("tests/pipelines/test_x.py", True),
        ("lmd/run.py", False),
    ],
)
def test_a_thorough_test_runs_when_what_it_tests_has_changed(changed, due, monkeypatch):
    monkeypatch.setattr(thorough, "changes", lambda _: [changed])
    assert thorough.is_due(item("pipelines/operations"), "HEAD~1") == due


def test_without_an_answer_of_git_all_files_count_as_changed():
    assert {"pipelines/optimise.py", "lmd/run.py"} <= set(thorough.changes("no-such-revision"))
