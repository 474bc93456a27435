"""`lmd` names arguments; only the pipelines know the configuration, and benchmarks its commands."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
GROUPS = sorted({*(path.parent.name for path in (ROOT / "conf").glob("*/*.yaml")), "budget", "start", "bound"})
KEY = re.compile(rf"(?<![\w.])({'|'.join(GROUPS)})(\.(?!yaml)[a-z]|=\w)")


def modules():
    for path in sorted((ROOT / "lmd").rglob("*.py")):
        yield pytest.param(path, id=str(path.relative_to(ROOT / "lmd")))


def messages(path):
    """The texts of a module that are not its documentation."""
    tree = ast.parse(path.read_text())
    documentation = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and isinstance(node.body[0], ast.Expr)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in documentation:
            yield node.value


@pytest.mark.parametrize("path", list(modules()))
def test_no_message_of_the_library_names_a_config_key(path):
    assert [text for text in messages(path) if KEY.search(text)] == []


def test_benchmarks_compose_only_commands_that_exist():
    sources = [path.read_text() for path in (ROOT / "benchmarks").glob("*.py")]
    composed = {name for text in sources for name in re.findall(r"\bcomposed?\(\s*\"(\w+)\"", text)}
    assert len(composed) > 1
    assert not [name for name in composed if not (ROOT / "conf" / f"{name}.yaml").exists()]
