"""The product that each law is run over: objectives x cameras x rooms x sizes of tags.

`law` makes a test of a function of a `Case`. `make test` runs it for the cells of a Graeco-Latin square of cameras and
rooms, with sizes and kinds of objectives, in which any two levels meet; `make test-thorough` runs it for all cells, and
so for fisheyes. A kernel is compiled for each kind of objective, camera, blockers and sizes: a cuboid and a floor plan
share kernels, and so do a pinhole and a lens that sees points.
"""

import itertools
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, reject
from hypothesis import strategies as st

from lmd.core.checks import InputError
from lmd.geometry.se3 import camera_pose
from lmd.geometry.trajectory import Trajectory
from lmd.objectives.coverage import Coverage, MeanCoverage
from lmd.objectives.filtered import Drives, Filtered
from lmd.objectives.localisation import Localisation
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.space.crowd import Crowd
from lmd.space.cuboid import Cuboid
from lmd.space.floor_plan import FloorPlan
from support.drives import along
from support.rooms import L_SHAPE, PILLAR, RACK, lab, mesh_room, prisms
from support.strategies import (
    BENT,
    FISHEYE,
    cameras,
    deployments,
    distorted_cameras,
    fiducials,
    is_bent,
    pdfs_of,
    rigs,
    rolled_pdfs,
    rooms,
    scenes_with_boundary_landmarks,
    seeds,
    visibilities,
    with_probabilities,
)
from support.thorough import examples

OBJECTIVES = ("coverage", "localisation", "one_tag", "turned", "filtered")
CAMERAS = ("one", "rig", "lens", "fisheye")
ROOMS = ("cuboid", "plan", "mesh", "crowd")
SIZES = ("points", "tags", "sizes")
EDGES = (0.05, 0.1, 0.3)

SQUARE = (
    ("coverage", "one", "mesh", "tags"),
    ("filtered", "rig", "mesh", "sizes"),
    ("localisation", "lens", "mesh", "points"),
    ("one_tag", "one", "cuboid", "sizes"),
    ("coverage", "rig", "cuboid", "points"),
    ("filtered", "lens", "cuboid", "tags"),
    ("filtered", "one", "plan", "points"),
    ("turned", "rig", "plan", "tags"),
    ("coverage", "lens", "plan", "sizes"),
    # And a crowd, and what other tests compile too.
    ("coverage", "one", "crowd", "points"),
    ("coverage", "one", "cuboid", "points"),
    ("coverage", "one", "plan", "tags"),
)


@dataclass(frozen=True)
class Case:
    """One draw of a cell of the product."""

    objective: Any
    scene: Scene
    deployment: Deployment
    targets: Deployment
    """Poses that landmarks are moved to."""
    rng: np.random.Generator

    def values(self, evaluator, deployment=None):
        """Values of the objective at the positions of an evaluator, `(P,)`."""
        hung = deployment or self.deployment
        return self.objective.values(evaluator, hung.positions[None], hung.normals[None])[0]


# Of the square, each camera and the objectives with fields of their own: kernels of moves take longest to compile.
MOVES = (SQUARE[0], SQUARE[1], SQUARE[2], SQUARE[9], SQUARE[10])


def cells(quick=SQUARE):
    """All cells as parameters of a test; those that are not `quick` are thorough."""
    for cell in itertools.product(OBJECTIVES, CAMERAS, ROOMS, SIZES):
        objective, camera, room, sizes = cell
        # Neither a rig nor a filter sees a crowd; points have no second pose.
        crowded = room == "crowd" and (camera == "rig" or objective == "filtered")
        if not crowded and (objective in ("one_tag", "turned"), sizes) != (True, "points"):
            marks = () if cell in quick else pytest.mark.thorough
            yield pytest.param(cell, id="-".join(cell), marks=marks)


def law(number, *objectives, quick=SQUARE):
    """Decorator of a law, a function of a `Case`: a property test of `number` examples for each cell.

    Args:
        number: of examples, as `examples` has it.
        objectives: to which alone it applies.
        quick: cells that `make test` runs.
    """

    def of(check):
        @pytest.mark.parametrize("cell", [c for c in cells(quick) if not objectives or c.values[0][0] in objectives])
        @examples(number)
        @given(data=st.data())
        def test(cell, data):
            check(data.draw(cases(*cell)))

        test.__name__, test.__doc__, test.__module__ = check.__name__, check.__doc__, check.__module__
        return test

    return of


@cache
def mesh(spacing):
    with TemporaryDirectory() as folder:
        plan = FloorPlan(L_SHAPE, 2.5, holes=[PILLAR], obstacles=[RACK])
        return mesh_room(Path(folder) / "lab.glb", plan, spacing=spacing)


bent = distorted_cameras(BENT).filter(is_bent)
COVERAGES = st.one_of(*(st.builds(of, st.integers(1, 4), st.just(0.5)) for of in (Coverage, MeanCoverage)))


def localisations(n, rotations, ambiguity):
    return st.builds(
        Localisation,
        n=n,
        tolerance=st.sampled_from([0.005, 0.02, 0.1, 0.5, np.inf]),
        pixel_noise=st.sampled_from([0.2, 0.5]),
        rotation_tolerance=st.sampled_from(rotations),
        ambiguity=st.just(ambiguity),
        coverage_weight=st.sampled_from([0.0, 0.0, 0.3, 1.0]),
    )


def jumping(room, rng, most=11):
    """Drives that jump from one random pose to the next: frames that share nothing."""
    made = []
    for frames in rng.integers(2, 7, rng.integers(1, most)).tolist():
        angles = (rng.uniform(-widest, widest, frames) for widest in (np.pi, 0.6, 0.5))
        poses = camera_pose(room.sample(frames, rng), *angles)
        made.append(Trajectory(np.cumsum(rng.uniform(0.1, 1.0, frames)), poses))
    return Drives(made, turn_noise=0.01, motion_noise=0.05)


def filtered(room):
    return st.builds(
        Filtered,
        drives=seeds.map(lambda seed: jumping(room, np.random.default_rng(seed))),
        n=st.integers(1, 2),
        tolerance=st.sampled_from([0.01, 0.05, 0.3]),
        rotation_tolerance=st.sampled_from([None, 0.02, 0.3]),
        pixel_noise=st.sampled_from([0.5, 0.02]),
    )


def allowed(draw, strategy):
    """A draw that nothing refuses: a grid may have no position, or a room no place for its people."""
    try:
        return draw(strategy)
    except InputError:
        reject()


@st.composite
def crowds(draw, room):
    """People, some of whom stand before cameras."""
    radius, height = draw(st.floats(0.1, 0.45)), draw(st.floats(0.3, 2.4))
    many = {"states": 3, "clearance": 0.1, "seed": draw(st.integers(0, 99))}
    return Crowd(draw(st.integers(1, 8)), (radius / 2, radius), (height / 2, height), **many).drawn(room)


@st.composite
def scenes(draw, camera, room, sizes):
    """A scene, its tags of one size."""
    rig, points = camera == "rig", sizes == "points"
    # The reference looks from each place of each camera, of which there are as many as orientations.
    empty, spacing = rooms(cells=2 if rig else 3), 2.0 if rig else 1.5
    hall = st.sampled_from([Cuboid((6.0, 4.0, 2.5), (5.0, 3.0, 1.5), 1.0), lab(spacing=1.5)])
    spaces = {"cuboid": empty, "plan": prisms(spacing), "mesh": st.builds(mesh, st.just(spacing)), "crowd": hall}
    space = allowed(draw, spaces[room])
    # Rigs see tags through lenses that distort, where the test of the image takes long to compile.
    fisheye = distorted_cameras(FISHEYE)
    seen_by = {"one": cameras(), "rig": rigs(cameras() if points else bent), "lens": bent, "fisheye": fisheye}[camera]
    orientations = pdfs_of(6 if room == "cuboid" and not rig else 4)
    scene = Scene(
        space,
        draw(seen_by),
        draw(orientations if points else rolled_pdfs(orientations)),
        draw(visibilities() if points else fiducials()),
        draw(st.sampled_from([Tag(), Tag(0.1), Tag(0.3)])) if points else None,
        crowd=allowed(draw, crowds(space)) if room == "crowd" else None,
    )
    varied = room != "crowd" and draw(st.booleans())
    return with_probabilities(scene, draw(seeds)) if varied else scene


@st.composite
def cases(draw, objective, camera, room, sizes):
    """A `Case` of a cell."""
    scene, edge = draw(scenes(camera, room, sizes)), None
    if (camera, room, sizes) == ("one", "cuboid", "points") and draw(st.booleans()):
        scene, edge = draw(scenes_with_boundary_landmarks())
    asked = draw(
        {
            "coverage": COVERAGES,
            "localisation": localisations(st.integers(1, 3), [None], "ignored"),
            "one_tag": localisations(st.just(1), [None], "resolved"),
            "turned": localisations(st.just(1), [0.003, 10.0, 10.0], "resolved"),
            "filtered": filtered(scene.room),
        }[objective]
    )
    least, most = 2 if sizes == "sizes" else 1, 12 if room == "cuboid" else 8
    deployment, targets = (draw(deployments(scene.room, many, least)) for many in (most, 6))
    if edge is not None:
        deployment, targets = draw(st.sampled_from([(edge, targets), (deployment, edge)]))
    if sizes == "sizes":
        scene = scene.sized(np.resize(EDGES, len(deployment)))
    if objective == "filtered":
        scene = along(scene, asked.drives)
    return Case(asked, scene, deployment, targets, np.random.default_rng(draw(seeds)))
