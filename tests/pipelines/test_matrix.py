"""docs/matrix.md says what the code says; a few cells, nothing is compiled."""

import sys
from pathlib import Path

import pytest
from support.composing import composed

from lmd.core.checks import InputError
from pipelines.building import build_optimiser, build_problem

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "benchmarks"))
import matrix  # noqa: E402 # a script

CELLS = [
    (("fiducial", objective, "cuboid", "grid", camera), "optimise")
    for objective, camera in (("localisation", "rig"), ("mixed", "rig"), ("coverage", "rig"), ("coverage", "one"))
]


def told(cell, command):
    """What optimising says before it begins."""
    words = [word for word in matrix.overrides(cell, command) if not word.startswith("hydra.")]
    cfg = composed(command, *words)
    try:
        build_optimiser(cfg, 0).check(build_problem(cfg))
    except InputError as error:
        return str(error)
    return matrix.WORKS


@pytest.mark.parametrize(("cell", "command"), CELLS, ids=[" ".join(cell) for cell, _ in CELLS])
def test_a_cell_is_what_the_code_says(cell, command):
    assert matrix.kept()[cell, command] == told(cell, command)


def test_the_page_is_that_of_what_was_run():
    assert matrix.PAGE.read_text() == "\n".join(matrix.page(matrix.kept())) + "\n"
