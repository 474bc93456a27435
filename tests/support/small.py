"""A problem that takes no time, and optimisers to run on it: configured, stopped and resumed, of libraries."""

import math
from copy import deepcopy
from dataclasses import replace
from functools import cache, partial
from importlib import import_module

import numpy as np
import pytest

from lmd.objectives.coverage import Coverage
from lmd.optimisers.checkpoint import Checkpoint
from lmd.optimisers.genetic import EGA
from lmd.optimisers.ledger import Budget
from lmd.optimisers.pymoo import Pymoo
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment
from pipelines.building import build_optimiser
from support import composing
from support.paper import paper_room, paper_scene

composed = cache(composing.composed)

QUICK = {"annealing", "camera_annealing", "cma_es", "ega"}  # one of each kind
# Files in conf/optimiser with other parameters of a class that another file, or the tests of wrappers, have too.
OTHERS = {"ega_tuned", "one_plus_one", "pattern_search", "prima"}
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


SETTINGS = {"seed": 0, "objective.n": 2, "camera.rig": [{"yaw": 0.5}], "tag": None, "room.height": math.inf}
BUDGET = 100


def stopped(optimiser, p, evaluations=BUDGET // 2):
    optimiser.run(p, Budget(BUDGET), lambda o: o.ledger.evaluations >= evaluations)
    return optimiser


def saved(directory, p):
    Checkpoint(stopped(EGA(), p), SETTINGS, "abc").save(directory)
    return directory


def resumed(directory, p, settings=SETTINGS, optimiser=None):
    checkpoint = Checkpoint(optimiser or EGA(), settings)
    checkpoint.resume(directory, p)
    return checkpoint


def run(optimiser, batches, dim=12, fitness=lambda genes: -np.abs(genes - 0.3).sum(axis=1)):
    """Start or go on with an optimiser; returns the batches it asked for."""
    if not optimiser.ledger.evaluations:
        optimiser.dim, optimiser.rng, optimiser.start = dim, np.random.default_rng(0), np.full((1, dim), 0.6)
    asked = []
    for _ in range(batches):
        asked.append(optimiser.ask())
        optimiser.tell(asked[-1], fitness(asked[-1]))
    return asked


def pymoo(name, **parameters):
    modules = {"PatternSearch": "pattern", "MixedVariableGA": "core.mixed"}
    module = modules.get(name, name.lower())
    within = "pymoo." if "." in module else "pymoo.algorithms.soo.nonconvex."
    return Pymoo(partial(getattr(import_module(within + module), name), **parameters))
