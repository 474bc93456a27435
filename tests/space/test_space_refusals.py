"""Bad rooms get one sentence."""

import numpy as np
import pytest
from support.paper import paper_room
from support.rooms import L_SHAPE, lab, walls_of
from support.tables import refusals

from lmd.formats.meshes import read_mesh_room
from lmd.scene.deployment import Deployment
from lmd.space.crowd import Crowd
from lmd.space.cuboid import Cuboid
from lmd.space.floor_plan import FloorPlan
from lmd.space.parts import Reachable
from lmd.space.prism import Prism, from_floor_plan
from lmd.space.space import Relevance

PLAN = {"outline": L_SHAPE, "height": 2.5, "reachable": {"height": [0.5, 1.5], "clearance": 0.3}, "spacing": 0.5}
MESH = {"path": "good.ply", "reachable": {"height": [0.5, 1.5], "clearance": 0.5}, "spacing": 0.5}


@pytest.fixture(autouse=True)
def _mesh(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    walls_of(FloorPlan([[0, 0], [6, 0], [6, 4], [0, 4]], 2.5)).export("good.ply")


test_what_cannot_be_is_refused_in_one_sentence = refusals(
    __file__,
    **{
        "a room": paper_room,
        "a file of relevance": lambda path: Relevance(path=path).weights(np.ones((1, 3))),
        "relevance of a room": lambda **given: Relevance(**given).weights(paper_room().grid()),
        "a crowd": lambda **given: Crowd(**given).drawn(Cuboid((6.0, 4.0, 2.5), (5.0, 3.0, 1.5), 1.0)),
        "a floor plan": lambda **given: from_floor_plan(**{**PLAN, **given}),
        "a landmark on a floor plan": lambda place, normal: Deployment([place], [normal]).movable(lab()),
        "positions that are drawn": lambda outline, clearance: Prism(
            FloorPlan(outline, 2.5), Reachable((0.5, 1.5), clearance), 0.5, "vertices"
        ).sample(10, np.random.default_rng(0)),
        "a room from a mesh": lambda *path, **given: read_mesh_room(
            **{**MESH, **given, **dict(zip(["path"], path, strict=False))}
        ),
    },
)
