"""Moves of landmarks, of every objective; most of the time is for compiling."""

from dataclasses import replace

import pytest
from contracts.field import check_field
from support.exact import check_exact
from support.product import MOVES, law

pytestmark = pytest.mark.long


@law(60, quick=MOVES)
def test_a_tried_move_has_the_values_of_a_full_evaluation_and_an_undone_one_leaves_no_trace(case):
    moved = check_field(case.objective, case.scene, case.deployment, case.targets, case.rng)
    check_exact(replace(case, deployment=moved))
