"""Refusals of the wrapped libraries: impossible parameters, what is no genes, and failures in a run."""

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.optimize import differential_evolution
from support.paper import paper_room
from support.small import pymoo, run
from support.tables import refusals

from lmd.core.checks import InputError
from lmd.optimisers.annealing import Stage
from lmd.optimisers.base import AskTell
from lmd.optimisers.encoding import make_encoding
from lmd.optimisers.nevergrad import Nevergrad
from lmd.optimisers.scipy import Scipy
from lmd.scene.deployment import Deployment
from lmd.scene.tag import Tag

PAIRS = {"temperature": [1e-3, 1e-4], "width": [0.1, 0.01], "step": [1.0, 0.1]}


class Asking(AskTell):
    """Asks for what it is told to."""

    def _ask(self):
        return self.asked

    def _tell(self, genes, fitness):
        pass


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ([np.nan] * 12, "Asking proposed NaN for 12 of 12 genes, after 0 evaluations."),
        (np.where(np.eye(12) > 0, np.nan, 0.5), "Asking proposed NaN for 12 of 144 genes"),
        (["a"] * 12, "Asking proposed ['a', 'a'"),
        ([["0.1"] * 12, [None] * 11], "Asking proposed [['0.1'"),
        (object, "Asking proposed <class 'object'>, not an array of genes (B, 12)."),
        ([[0.5] * 11], "Asking proposed genes of shape (1, 11), not (B, 12)."),
        ([], "Asking proposed genes of shape (1, 0), not (B, 12)."),
    ],
)
def test_what_is_no_genes_is_refused_at_once_with_the_name_of_what_asked(asked, message):
    optimiser = Asking()
    optimiser.asked = asked
    with pytest.raises(InputError) as told:
        run(optimiser, 1)
    assert str(told.value).startswith(message)
    optimiser.asked = [0.5] * 12
    run(optimiser, 3)
    optimiser.asked = asked
    with pytest.raises(InputError, match=re.escape(message.replace("after 0", "after 3"))):
        run(optimiser, 1)


def start(place, normal, kind="wall", flush=True):
    return make_encoding(kind, paper_room(), flush).encode(Deployment([place], [normal]))


def sizes(number=18, **changes):
    return replace(Tag(0.1, edges=(0.05, 0.1, 0.3), counts=(10, 6, 2)), **changes).edges_in_order(number)


CALLS = {
    "a stage of annealing": lambda **changes: Stage(**(PAIRS | changes)),
    "a start": start,
    "tags of several sizes": sizes,
    "an algorithm of pymoo": pymoo,
}
test_what_cannot_be_is_refused_in_one_sentence = refusals(__file__, **CALLS)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Scipy(np.linalg.norm), r"^minimise must be a function of an objective and bounds, got <function norm"),
        (
            lambda: Nevergrad("DS9", workers=2),
            r"^nevergrad's DS9 failed: ValueError: .* support parallelization \(base\.py, line \d+\)\.$",
        ),
        (
            lambda: Scipy(partial(differential_evolution, strategy="best")),
            r"^differential_evolution failed: ValueError: Please select a valid mutation strategy",
        ),
    ],
)
def test_a_library_that_fails_in_the_run_says_why(make, message):
    with pytest.raises(InputError, match=message):
        run(make(), 3)
