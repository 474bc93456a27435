"""Genes from users: a wrong length or a value outside the box is refused in one sentence."""

import numpy as np
import pytest
from support.small import problem

from lmd.cameras.body import Body
from lmd.cameras.mounts import MountSpace
from lmd.cameras.problem import CameraProblem
from lmd.core.checks import InputError
from lmd.optimisers.encoding import LandmarkGenome


def landmarks():
    return LandmarkGenome(problem(), "wall", True)


def cameras():
    p = problem()
    body = Body([{"low": [-0.2, -0.15, 0.0], "high": [0.2, 0.15, 0.2]}])
    return CameraProblem(p, p.draw(np.random.default_rng(0)), MountSpace(body, (p.scene.camera,), 2))


@pytest.mark.parametrize("make", [landmarks, cameras])
def test_genes_that_are_none_of_the_problem_are_refused(make):
    genome = make()
    good = np.full((2, genome.dim), 0.5)
    assert genome.fitness_of_genes(good).shape == (2,)
    for bad, message in [
        (good[0], rf"genes must have the shape \(B, {genome.dim}\), got \({genome.dim},\)"),
        (good[:, :-1], rf"genes must have the shape \(B, {genome.dim}\), got \(2, {genome.dim - 1}\)"),
        (good + 1.0, r"genes must be in \[0, 1\], got 1.5"),
        (good * np.nan, r"genes must be in \[0, 1\], got nan"),
        (["a"], r"genes must be real numbers, got \['a'\]"),
    ]:
        with pytest.raises(InputError, match=message):
            genome.fitness_of_genes(bad)
    decode = genome.deployment if make is landmarks else genome.rig
    with pytest.raises(InputError, match=rf"genes must have the shape \({genome.dim},\), got \(2, {genome.dim}\)"):
        decode(good)
