"""Refusals of the wrapped libraries: impossible parameters, what is no genes, and failures in a run."""

import re
from functools import partial

import numpy as np
import pytest
from scipy.optimize import differential_evolution
from support.small import OneByOne, pymoo, run

from lmd.core.checks import InputError
from lmd.optimisers.genetic import RandomSearch
from lmd.optimisers.nevergrad import Nevergrad
from lmd.optimisers.pycma import PyCma
from lmd.optimisers.pymoo import Pymoo
from lmd.optimisers.scipy import Scipy
from lmd.optimisers.wrapped import AskAndTell


class Asking:
    """Asks for what it is told to."""

    def __init__(self, x0, asked):
        self.asked = asked

    def ask(self):
        return self.asked

    def tell(self, genes, losses):
        pass


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ([np.nan] * 12, "Asking asked for genes of which 12 of 12 are NaN, after 0 evaluations."),
        (np.where(np.eye(12) > 0, np.nan, 0.5), "Asking asked for genes of which 12 of 144 are NaN"),
        (["a"] * 12, "Asking asked for ['a', 'a'"),
        ([["0.1"] * 12, [None] * 11], "Asking asked for [['0.1'"),
        (object, "Asking asked for <class 'object'>, not for genes (B, 12)."),
        ([[0.5] * 11], "Asking asked for genes of shape (1, 11), not (B, 12)."),
        ([], "Asking asked for genes of shape (1, 0), not (B, 12)."),
    ],
)
def test_what_is_no_genes_is_refused_at_once_with_the_name_of_what_asked(asked, message):
    optimiser = AskAndTell(partial(Asking, asked=asked))
    with pytest.raises(InputError) as told:
        run(optimiser, 1)
    assert str(told.value).startswith(message)
    optimiser = AskAndTell(partial(Asking, asked=[0.5] * 12))
    run(optimiser, 3)
    optimiser.session.made.asked = asked
    with pytest.raises(InputError, match=re.escape(message.replace("after 0", "after 3"))):
        run(optimiser, 1)


class Broken(list):
    """Candidates that cannot be looked at."""

    def __len__(self):
        raise KeyError(3)


class Mute(Asking):
    """An optimiser without `tell`."""

    tell = None


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Pymoo("GA"), r"^algorithm must be a function of no arguments, got 'GA'"),
        (lambda: Pymoo(dict), r"^algorithm makes a dict, not a pymoo algorithm"),
        (
            lambda: pymoo("DE", variant="DE/rand"),
            r"^algorithm cannot be made: Please provide a valid variant",
        ),
        (lambda: pymoo("GA", pop_size=-1), r"^algorithm\.pop_size must be at least 1, got -1"),
        (lambda: Nevergrad("DE", workers=0), r"^workers must be at least 1, got 0"),
        (lambda: Nevergrad("DE", step=0), r"^step must be greater than 0, got 0"),
        (lambda: Nevergrad("DE", budget=0.5), r"^budget must be a whole number, got 0\.5"),
        (lambda: Scipy("DE"), r"^minimise must be a function of an objective and bounds, got 'DE'"),
        (lambda: Scipy(np.linalg.norm), r"^minimise must be a function of an objective and bounds, got <function norm"),
        (lambda: PyCma("sparse"), r"^variant must be one of full, separable, vkd, got 'sparse'"),
        (lambda: PyCma(step=-1), r"^step must be greater than 0, got -1"),
        (lambda: PyCma(population=2), r"^population must be at least 4, got 2"),
        (lambda: RandomSearch(batch=0), r"^batch must be at least 1, got 0"),
        (lambda: AskAndTell(OneByOne), r"^start must be one of mean, step, seed, bounds, got 'x0'"),
        (lambda: AskAndTell(3), r"^make must be a class or a function, got 3"),
        (
            lambda: Nevergrad("DifferentialEvolution", options={"genes": 2}),
            r"^options do not suit nevergrad's DifferentialEvolution: .*genes",
        ),
        (
            lambda: Nevergrad("TwoPointsDE", options={"popsize": 10}),
            r"^name = 'TwoPointsDE' is not a family that takes options",
        ),
        (
            lambda: Nevergrad("TwoPointDE"),
            r"^name = 'TwoPointDE' is not an optimiser of .*; close: TwoPointsDE",
        ),
    ],
)
def test_impossible_parameters_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: AskAndTell(OneByOne, start="mean"), r"^OneByOne failed: TypeError: .*step"),
        (
            lambda: AskAndTell(partial(Mute, asked=[0.5])),
            r"^make: .*Mute makes an object without the method tell\.",
        ),
        (
            lambda: Nevergrad("DS9", workers=2),
            r"^nevergrad's DS9 failed: ValueError: .* support parallelization \(base\.py, line \d+\)\.$",
        ),
        (
            lambda: AskAndTell(partial(Asking, asked=Broken())),
            r"^Asking failed: KeyError: 3 \(test_.*\.py, line \d+\)\.$",
        ),
        (
            lambda: Scipy(partial(differential_evolution, strategy="best")),
            r"^differential_evolution failed: ValueError: Please select a valid mutation strategy",
        ),
    ],
)
def test_a_library_that_fails_in_the_run_says_why(make, message):
    optimiser = make()
    with pytest.raises(InputError, match=message):
        run(optimiser, 3)
