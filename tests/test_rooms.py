"""The plan of the house: what each package of `lmd` may import, and that no modules import each other in a circle."""

import ast
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import lmd

ROOT = Path(lmd.__file__).parent
# From the ground up: a package imports from those before it, and from itself.
FLOORS = (
    *("core", "geometry", "space", "scene", "formats", "render", "orientation", "sight", "incremental", "objectives"),
    *("problem", "cameras", "optimisers", "detection", "adjust", "estimation", "export", "survey", "localise"),
    *("evaluation", "run", "suite", "plot", "planner"),
)
MODULES = {
    ".".join(("lmd", *path.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__"): path
    for path in ROOT.rglob("*.py")
}


@cache
def imports(module):
    """The modules of `lmd` that one imports, wherever in it: also when first needed, and for type checkers alone."""
    found = set()
    for node in ast.walk(ast.parse(MODULES[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} has a relative import in line {node.lineno}"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return {resolved for name in found if name.split(".")[0] == "lmd" and (resolved := home(name)) != module}


def home(name):
    """The module in which a dotted name is found."""
    while name not in MODULES:
        name = name.rpartition(".")[0]
    return name


def floor(module):
    return FLOORS.index(module.split(".")[1])


INSIDE = sorted(set(MODULES) - {"lmd"})


def test_nothing_lies_loose_at_the_top():
    assert {name for name in MODULES if name.count(".") == 1 and MODULES[name].name != "__init__.py"} == {
        "lmd.problem",
        "lmd.run",
    }
    assert {name.split(".")[1] for name in INSIDE} == set(FLOORS)


@pytest.mark.parametrize("room", FLOORS)
def test_no_import_runs_up_a_floor(room):
    """Nor does any module import `lmd` itself, which imports all of them."""
    modules = [module for module in INSIDE if module.split(".")[1] == room]
    up = [
        f"{module} imports {other}"
        for module in modules
        for other in sorted(imports(module))
        if other == "lmd" or floor(other) > floor(module)
    ]
    assert up == []


def test_no_modules_import_each_other_in_a_circle():
    TopologicalSorter({module: imports(module) for module in INSIDE}).prepare()
