"""Bad bodies and mounts get one sentence."""

import numpy as np
from support.tables import refusals
from test_body import space


def mounts(count=1, lenses=None, **limits):
    own = {} if lenses is None else {"lenses": lenses}
    return space(count, **own, **limits).draw(np.random.default_rng(0))


test_what_cannot_be_is_refused_in_one_sentence = refusals(__file__, mounts=mounts)
