"""Strategies of the property tests of rigs, and the rigs that several tests need."""

import math

import numpy as np
from hypothesis import strategies as st
from strategies import (
    BENT,
    cameras,
    deployments,
    distorted_cameras,
    fiducials,
    is_bent,
    pdfs,
    pdfs_of,
    rolled_pdfs,
    rooms,
    visibilities,
)

from lmd.scene.rig import Mount, Rig
from lmd.scene.scene import Scene

angles = st.one_of(st.sampled_from([0.0, math.pi / 2, math.pi]), st.floats(-math.pi, math.pi))
translations = st.one_of(st.just((0.0, 0.0, 0.0)), st.just((0.0, 0.0, 0.2)), st.tuples(*[st.floats(-0.5, 0.5)] * 3))


@st.composite
def mounts(draw, kinds):
    camera, translation = draw(st.sampled_from(kinds)), draw(translations)
    if draw(st.booleans()):
        return Mount(camera, translation, draw(angles), draw(angles), draw(angles))
    quaternion = np.random.default_rng(draw(st.integers(0, 99))).normal(size=4)
    return Mount(camera, translation, quaternion=quaternion / np.linalg.norm(quaternion))


@st.composite
def rigs(draw, any_camera=cameras()):  # noqa: B008
    """Rigs of two or three cameras of two kinds: for another number of kinds much would be compiled anew."""
    found = draw(st.lists(any_camera, min_size=2, max_size=2, unique=True))
    each = tuple(draw(mounts([camera])) for camera in found)
    return Rig(each + tuple(draw(st.lists(mounts(found), max_size=1))))


@st.composite
def rig_scenes_with_deployments(draw, fiducial=False, room=None):
    # The reference looks from each place of each camera, of which there are as many as orientations.
    room = draw(rooms(cells=2) if room is None else room)
    seen = draw(fiducials() if fiducial else visibilities())
    # Tags are seen through lenses that distort, where the test of the image takes long to compile: once.
    rig = draw(rigs(distorted_cameras(BENT).filter(is_bent) if fiducial else cameras()))
    few = pdfs_of(4)  # with rolls they are still more than a word of bits holds
    scene = Scene(room, rig, draw(rolled_pdfs(few) if fiducial else pdfs), seen)
    return scene, draw(deployments(room, most=8))
