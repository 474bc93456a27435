"""Small problems for integer programs, and the best of all choices of poses on their lattices."""

from dataclasses import replace
from itertools import combinations, combinations_with_replacement

import numpy as np
from paper import paper_room, paper_scene

from lmd.objectives.coverage import Coverage
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.deployment_sources import RandomDeployment
from lmd.sight.poses import candidate_poses
from lmd.space.relevance import Relevance

SPACING = 1.5
PLENTY = Budget(10_000)


def problem(count=3, n=2, thold_p=0.04, tag=None, fixed=None, start=None, relevance=None, occlusion="none"):
    room = paper_room(
        size=(3.0, 3.0, 2.5), reachable_size=(2.0, 2.0, 1.5), spacing=1.0, relevance=relevance or Relevance()
    )
    scene = replace(paper_scene(room, orientations=pdf.grid_with_ends(6), occlusion=occlusion), tag=tag)
    return Problem(scene, Coverage(n, thold_p), start or RandomDeployment(count), 1, fixed)


def best_of_all(p, spacing=SPACING):
    """The fitness of the best choice of poses: points in stacks that nothing hides, papers that do not overlap."""
    footprints = p.scene.footprints
    poses = candidate_poses(footprints.hanging, spacing)
    choices = combinations if footprints.edge else combinations_with_replacement
    chosen = np.array([
        each
        for each in choices(range(len(poses)), p.free_count)
        if not footprints.edge
        or not any(footprints.touched(poses[[i]], poses[[j]])[0] for i, j in combinations(each, 2))
    ])  # fmt: skip
    positions, normals = poses.positions[chosen], poses.normals[chosen]
    if p.fixed is not None:
        there = p.fixed.positions, p.fixed.normals
        positions, normals = (
            np.concatenate([np.broadcast_to(first, (len(chosen), *first.shape)), then], axis=1)
            for first, then in zip(there, (positions, normals), strict=True)
        )
    return p.fitness(positions, normals).max()
