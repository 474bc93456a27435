"""Optimisers of one's own are checkpointed, or say that they cannot be."""

from pathlib import Path

import numpy as np
import pytest
from support.small import BUDGET, SETTINGS, problem, resumed, saved, stopped

from lmd.core.checks import InputError
from lmd.optimisers.base import Optimiser
from lmd.optimisers.checkpoint import Checkpoint
from lmd.optimisers.genetic import RandomSearch
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem


@pytest.fixture(scope="module")
def small():
    return problem()


class Remembering(RandomSearch):
    """An optimiser that keeps more than its parent, in classes of its own."""

    def __init__(self, seed=0):
        super().__init__(10, seed=seed)
        self.memory = {(0, "any key"): [object()]}
        self.mean = 0.0

    def _ask(self):
        return super()._ask() * 0.9 + 0.1 * self.mean

    def _tell(self, genes, fitness):
        self.memory[float(fitness[0]), "key"] = genes
        self.mean = genes[np.argmax(fitness)]


class Elsewhere(RandomSearch):
    """Its random numbers are not those it is given."""

    def _ask(self):
        return np.random.default_rng().random((4, self.dim))


class Own(Optimiser):
    """A method that says nothing of its state."""

    def run(self, problem, budget, callback=None):
        raise NotImplementedError

    def found(self, problem):
        return None


class Careless(Own):
    """A method whose state is no data."""

    def state(self):
        return {"seen": [1, {"by": Path}]}


def test_whatever_asks_and_tells_is_checkpointed(tmp_path, small):
    whole, half = Remembering(seed=2), stopped(Remembering(seed=2), small)
    Checkpoint(half, SETTINGS).save(tmp_path)
    again = resumed(tmp_path, small, optimiser=Remembering(seed=2)).optimiser
    assert len(again.memory) == len(half.memory)
    np.testing.assert_array_equal(
        again.run(small, Budget(BUDGET)).deployment.positions, whole.run(small, Budget(BUDGET)).deployment.positions
    )


def test_nothing_is_evaluated_to_go_on(tmp_path, small, monkeypatch):
    saved(tmp_path, small)
    monkeypatch.setattr(Problem, "fitness", lambda *_: pytest.fail("it is known already"))
    assert resumed(tmp_path, small).optimiser.ledger.evaluations >= BUDGET // 2


def test_genes_that_cannot_be_had_again_are_a_sentence(tmp_path, small):
    Checkpoint(stopped(Elsewhere(), small), SETTINGS).save(tmp_path)
    with pytest.raises(InputError, match=r"Elsewhere cannot be resumed: it proposes other genes"):
        resumed(tmp_path, small, optimiser=Elsewhere())


@pytest.mark.parametrize(
    ("optimiser", "message"),
    [
        (Own(), r"^Own cannot be checkpointed: it has no state to be saved$"),
        (
            Careless(),
            r"^Careless cannot be checkpointed: its state\.seen\.1\.by is a type, which is neither a number, a text",
        ),
    ],
)
def test_a_class_that_cannot_be_checkpointed_says_so(optimiser, message, tmp_path, small):
    with pytest.raises(InputError, match=message):
        Checkpoint(optimiser, {}).check()
    saved(tmp_path, small)
    with pytest.raises(InputError, match=rf"{type(optimiser).__name__} cannot be checkpointed"):
        resumed(tmp_path, small, optimiser=optimiser)


def test_plain_states_of_every_kind_come_back(tmp_path, small):
    class Plain(Own):
        kept = {"a": [1, 2.5, None, True, "text"], "b": {"c": np.arange(3), "d": [np.eye(2), np.int64(7)]}}  # noqa: RUF012

        def state(self):
            return self.kept

        def restore(self, state, problem):
            self.again = state

    Checkpoint(Plain(), SETTINGS).save(tmp_path)
    again = resumed(tmp_path, small, optimiser=Plain()).optimiser.again
    assert again["a"] == Plain.kept["a"]
    np.testing.assert_array_equal(again["b"]["c"], np.arange(3))
    np.testing.assert_array_equal(again["b"]["d"][0], np.eye(2))
    assert again["b"]["d"][1] == 7
