"""Bad input of scenes gets one sentence."""

import numpy as np
from support.paper import paper_camera, paper_room
from support.rooms import lab, recorded
from support.small import problem
from support.tables import refusals

from lmd.formats.rigs import rig_of
from lmd.formats.tag_maps import FileDeployment
from lmd.scene.deployment import Deployment
from lmd.scene.tag import Tag


def landmarks(path, count=None, **options):
    return FileDeployment(path, count, **options).draw(paper_room(), np.random.default_rng(0))


def hanging(places, normals, edge=None):
    return problem(fixed=Deployment(places, normals), tag=Tag(edge))


def rig(path=None, mounts=None, **keys):
    return rig_of({"path": path, **keys}) if mounts is None else rig_of(mounts, paper_camera())


CALLS = {
    "a file of landmarks": landmarks,
    "a landmark that hangs already": hanging,
    "a recording of poses": lambda *path, room="paper", **settings: recorded(*path, **settings).visited(
        lab() if room == "lab" else paper_room()
    ),
    "a rig": rig,
}
test_what_cannot_be_is_refused_in_one_sentence = refusals(__file__, **CALLS)
