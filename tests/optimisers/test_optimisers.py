"""The contract of every optimiser, checked for every config in conf/optimiser."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from contracts.optimiser import check_optimiser
from support.small import make, marked, problem

from lmd.core.checks import InputError
from lmd.optimisers.base import AskTell
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from pipelines.app import CONF

# What begins with a lattice is no search that a budget of any size serves, and cameras are no landmarks: these have
# tests of their own.
LATTICES = {"milp"}
NAMES = {path.stem for path in Path(CONF, "optimiser").glob("*.yaml")} - {"camera_annealing", *LATTICES}


@pytest.mark.parametrize("name", marked(NAMES))
def test_every_optimiser_keeps_its_contract(name, tmp_path):
    check_optimiser(partial(make, name), problem, tmp_path)


def test_a_run_in_which_every_evaluation_fails_says_so():
    class Hopeless(Problem):
        def fitness(self, positions, normals):
            return np.full(len(positions), np.nan)

    p = problem()
    with pytest.raises(InputError, match="EGA found no deployment: every evaluation failed"):
        make("ega").run(Hopeless(p.scene, p.objective, p.start), Budget(40))


def test_genes_outside_the_unit_box_are_clipped():
    class Outside(AskTell):
        def _ask(self):
            return np.full((2, self.dim), 7.0)

        def _tell(self, genes, fitness):
            assert genes.max() == 1.0

    Outside().run(problem(), Budget(4))
