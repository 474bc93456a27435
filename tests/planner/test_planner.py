"""The planner and its picture without a browser."""

import numpy as np
import pytest
from support.small import problem

from lmd.core.checks import InputError
from lmd.optimisers.genetic import RandomSearch
from lmd.optimisers.ledger import Budget
from lmd.planner.panel import PlannerPanel
from lmd.planner.server import Planner
from lmd.planner.session import PlanningSession

viser = pytest.importorskip("viser")


class Shown(KeyboardInterrupt):
    """A text of the panel; ends the planner as Ctrl-C does."""


@pytest.fixture
def planner():
    """Makes planners."""
    made = []

    def make(planned):
        session = PlanningSession(planned, planned.draw(np.random.default_rng(0)))
        made.append(Planner(session, 0, lambda _: "", RandomSearch, Budget(1), seed=0))
        return made[0]

    yield make
    made[0].close()


def test_a_failure_of_background_work_is_shown(planner, monkeypatch):
    def fail(*_):
        raise InputError("that is too big.")

    def say(_, text, refused=False):
        if refused:
            raise Shown(text)

    monkeypatch.setattr("lmd.planner.background.additions", fail)
    monkeypatch.setattr(PlannerPanel, "say", say)
    with pytest.raises(Shown, match=r"^that is too big\.$"):
        planner(problem()).run()
