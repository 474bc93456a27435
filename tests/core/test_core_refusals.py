"""Bad numbers, bad files, and what would not fit into memory get one sentence."""

import numpy as np
from support.paper import paper_room, paper_scene
from support.tables import refusals

from lmd.core.files import read_keys
from lmd.core.tables import read_numbers
from lmd.estimation.flights import Pace, RandomMotion
from lmd.sight.poses import candidate_poses


def flight(duration, speed, turn_rate):
    return RandomMotion(duration, Pace(speed, turn_rate, 20.0)).draw(paper_scene(), np.random.default_rng(0))


test_what_cannot_be_is_refused_in_one_sentence = refusals(
    __file__,
    **{
        "a room": paper_room,
        "a flight": flight,
        "candidate poses": lambda spacing: candidate_poses(paper_room(), spacing),
        "numbers of a table": lambda path: read_numbers(path, ("x", "y"), name="path"),
        "keys of a file": lambda path: read_keys(path, "path"),
    },
)
