"""A scene with tags, and drives through it."""

from dataclasses import replace

import numpy as np
from paper import paper_room, paper_scene

from lmd.estimation.flights import Pace, RandomMotion
from lmd.estimation.recording import Odometry
from lmd.scene.deployment_sources import UniformDeployment
from lmd.scene.tag import Tag
from lmd.space.driven import DrivenRoom

SCENE = replace(paper_scene(paper_room(spacing=2.0)), tag=Tag(0.15))
PACE = Pace(speed=1.0, turn_rate=1.0, frame_rate=5.0)
MOTION = RandomMotion(6.0, PACE)
SLOW = Odometry(turn_noise=0.001, motion_noise=0.005)
DEPLOYMENT = UniformDeployment(60).draw(SCENE.room, np.random.default_rng(0))


def along(scene, drives):
    return replace(scene, room=DrivenRoom(scene.room, drives.positions, drives.seconds))
