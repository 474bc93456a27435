"""Figures off the grid: soon, then all digits, and given up as soon as nobody wants them."""

from itertools import count

import numpy as np
from small import problem

from lmd.evaluation.validation import Sample, describe_validation, validation_metrics
from lmd.planner.off_grid import ESTIMATE, FIRST_SAMPLE, off_grid

SMALL = Sample(groups=4, positions=32, divisions=4)


def test_a_first_estimate_comes_before_the_figures_of_evaluate(monkeypatch):
    monkeypatch.setattr("lmd.planner.off_grid.Sample", lambda: SMALL)
    planned = problem()
    tags = planned.draw(np.random.default_rng(0))
    first, whole = off_grid(planned, tags, 5, lambda: True)
    for rows, sample, more in ((first, FIRST_SAMPLE, ESTIMATE), (whole, SMALL, {})):
        assert rows == describe_validation(planned, validation_metrics(planned, tags, 5, sample)) | more


def test_it_is_given_up_before_the_next_group_of_positions(monkeypatch):
    planned = problem()
    tags, evaluated, values = planned.draw(np.random.default_rng(0)), [], type(planned.objective).values
    monkeypatch.setattr(
        type(planned.objective), "values", lambda *args: (evaluated.append(len(args[1].positions)), values(*args))[1]
    )
    for last in (1, 3, FIRST_SAMPLE.groups + 1, FIRST_SAMPLE.groups + 3):
        evaluated.clear()
        asked = count()
        rows = list(off_grid(planned, tags, 0, lambda asked=asked, last=last: next(asked) < last))
        assert len(rows) == (last > FIRST_SAMPLE.groups)
        assert len(evaluated) <= last + 2  # the finer grid of either sample is not asked about
