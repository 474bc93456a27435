"""A process that has imported `lmd` and used it: kernels are compiled, and others are read from disk."""

from support import small

import lmd
from lmd.core.compiled import inner, kernel


@inner
def half(x):
    return 0.5 * x


@kernel
def half_and_one(x):
    return half(x) + 1.0


assert half_and_one(3.0) == 2.5
lmd.optimise(small.problem(), evaluations=31)
