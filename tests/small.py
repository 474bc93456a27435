"""A problem that takes no time, and the configured optimisers."""

from copy import deepcopy
from dataclasses import replace
from functools import cache

import composing
import pytest
from paper import paper_room, paper_scene

from lmd.objectives.coverage import Coverage
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment
from pipelines.building import build_optimiser

composed = cache(composing.composed)

QUICK = {"annealing", "camera_annealing", "cma_es", "ega"}  # one of each kind
# Files in conf/optimiser with other parameters of a class that another file has too.
OTHERS = {"ega_tuned", "one_plus_one"}
OTHER = pytest.mark.thorough("conf/optimiser", "constraints.txt", "lmd/optimisers", "tests/contracts")


def marked(names):
    """Names of optimisers as parameters of a test."""
    return [pytest.param(name, marks=_marks(name)) for name in sorted(names)]


def _marks(name):
    slow = () if name in QUICK else (pytest.mark.slow,)
    return (*slow, OTHER) if name in OTHERS else slow


@cache
def _built(name, seed):
    return build_optimiser(composed("optimise", f"optimiser={name}"), seed)


def make(name, seed=0):
    return deepcopy(_built(name, seed))  # in a tenth of the time


def problem(start=None, threads=1, fixed=None, tag=None, **room):
    scene = replace(paper_scene(paper_room(spacing=1.5, **room), orientations=pdf.grid_with_ends(6)), tag=tag)
    return Problem(scene, Coverage(2, 0.5), start or RandomDeployment(30), threads, fixed)
