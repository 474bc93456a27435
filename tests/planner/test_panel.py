"""Texts of the panel, and values that are typed into it."""

import math

import numpy as np
import pytest

from lmd.core.checks import InputError
from lmd.optimisers.ledger import Budget
from lmd.planner.panel import TAGS, PlannerPanel
from lmd.planner.viewing import span_of

viser = pytest.importorskip("viser")


@pytest.fixture(scope="module")
def gui():
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server.gui
    server.stop()


@pytest.mark.parametrize("budget", [Budget(2000), Budget(None, 60.0), Budget(300, 1.5)])
def test_the_budget_of_a_search_is_shown_and_can_be_typed(gui, budget):
    panel = PlannerPanel(gui, "P", budget, ids=True)
    assert panel.budget == budget
    for name, field in panel._limits.items():
        before = field.value
        field.value = 7.0
        assert getattr(panel.budget, name) == 7
        for senseless in (0.0, -1.0, math.nan, math.inf):
            field.value = senseless
            with pytest.raises(InputError, match=name):
                panel.budget  # noqa: B018
        field.value = before


def test_the_legend_has_colours_with_numbers_that_span_the_values_that_are_there(gui):
    panel, values = PlannerPanel(gui, "P(see <2>)", Budget(1), ids=True), np.array([0.02, 0.071, 0.05])
    assert panel._legend.content.count("linear-gradient") == 1  # of positions
    assert "0.0% <span" in panel._legend.content
    panel.show_span(span_of(values))
    panel.show_legend(0.01422)
    told = ("2.0% <span", "</span> 7.1%", "linear-gradient(to right, rgb(68, 1, 84)", "+1.422%", "P(see &lt;2&gt;)")
    assert all(part in panel._legend.content for part in (*told, *TAGS))
    panel.show_span(span_of(np.zeros(3)))
    assert "</span> 100.0%" in panel._legend.content
