"""A problem that takes no time, and the configured optimisers."""

from dataclasses import replace
from functools import cache

from hydra import compose, initialize_config_dir
from paper import paper_room, paper_scene

from lmd.objectives.coverage import Coverage
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment
from pipelines.app import CONF
from pipelines.building import build_optimiser


@cache
def composed(pipeline, *overrides):
    """The configuration of a pipeline; composing takes a tenth of a second."""
    with initialize_config_dir(CONF, version_base="1.3"):
        return compose(pipeline, list(overrides))


def make(name, seed=0):
    return build_optimiser(composed("optimise", f"optimiser={name}"), seed)


def problem(start=None, threads=1, fixed=None, tag=None, **room):
    scene = replace(paper_scene(paper_room(spacing=1.5, **room), orientations=pdf.grid_with_ends(6)), tag=tag)
    return Problem(scene, Coverage(2, 0.5), start or RandomDeployment(30), threads, fixed)
