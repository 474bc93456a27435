"""Texts of the panel, and values that are typed into it."""

import math

import numpy as np
import pytest

from lmd.core.checks import InputError
from lmd.optimisers.ledger import Budget
from lmd.planner.panel import TAGS, PlannerPanel
from lmd.planner.plan import SearchProgress
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


def test_a_search_shows_its_share_of_the_budget_and_what_it_waits_for(gui, monkeypatch):
    panel = PlannerPanel(gui, "P", Budget(2000, 60.0), ids=True)
    for compiling, text in ((True, "compiling what this needs, once"), (False, "begins")):
        monkeypatch.setattr("lmd.planner.panel.is_compiling", lambda compiling=compiling: compiling)
        panel.show_progress(None, running=True)
        assert f">{text}<" in panel._progress.content
    panel.show_progress(SearchProgress(0.25, 0.4321, None), running=True)
    assert ">25% of 2000 evaluations or 60 seconds; best fitness 43.21%<" in panel._progress.content
    assert panel._bar.visible
    assert panel._bar.value == 25.0
    panel.show_progress(None, running=False)
    assert not panel._bar.visible


def test_a_size_is_chosen_where_there_are_several(gui):
    assert PlannerPanel(gui, "P", Budget(1), ids=True, edges=(0.1,)).edge is None
    panel = PlannerPanel(gui, "P", Budget(1), ids=True, edges=(0.1, 0.25))
    assert panel.edge == 0.1
    panel._size.value = "0.25 m"
    assert panel.edge == 0.25
    panel._size.value = "7 m"  # from an odd browser
    assert panel.edge is None


def test_the_legend_has_colours_with_numbers(gui):
    panel = PlannerPanel(gui, "P(see <2>)", Budget(1), ids=True)
    assert panel._legend.content.count("linear-gradient") == 1  # of positions
    panel.show_legend(0.01422)
    for part in ("linear-gradient(to right, rgb(68, 1, 84)", "+1.422%", "P(see &lt;2&gt;)", *TAGS):
        assert part in panel._legend.content


def test_colours_of_positions_span_the_values_that_are_there(gui):
    panel, values = PlannerPanel(gui, "P", Budget(1), ids=True), np.array([0.02, 0.071, 0.05])
    assert "0.0% <span" in panel._legend.content
    panel.show_span(span_of(values))
    assert "2.0% <span" in panel._legend.content
    assert "</span> 7.1%" in panel._legend.content
    panel.show_legend(0.5)
    assert "</span> 7.1%" in panel._legend.content  # a legend of surfaces leaves it
    panel.show_span(span_of(np.zeros(3)))
    assert "</span> 100.0%" in panel._legend.content
