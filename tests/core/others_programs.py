"""Programs of others with numba, run after `lmd` was used: each prints its result."""

import gc
import math
import time
from collections import namedtuple

import numpy as np
from numba import cfunc, float64, int64, njit, objmode, prange, types, vectorize
from numba.experimental import jitclass, structref
from numba.typed import Dict

thresholds = gc.get_threshold()
import used  # noqa: E402, F401

from lmd.core.compiled import clock  # noqa: E402

began, read = time.perf_counter(), clock()


@jitclass([("total", float64)])
class Sum:
    def __init__(self, start):
        self.total = start

    def add(self, x):
        self.total += x
        return self.total


print(Sum(1.0).add(2.5))

space = {}
exec("def square(x): return x * x", space)  # a function without a module
print(njit(space["square"])(7))


@structref.register
class PairType(types.StructRef):
    pass


class Pair(structref.StructRefProxy):
    def __new__(cls, one, other):
        return structref.StructRefProxy.__new__(cls, one, other)


structref.define_proxy(Pair, PairType, ["one", "other"])


@njit
def joined(pair):
    return pair.one + pair.other


print(joined(Pair(1, 2)))


@vectorize([float64(float64)])
def root(x):
    return math.sqrt(x)


print(root(np.array([4.0, 9.0])).tolist())


@cfunc(int64(int64))
def twice(x):
    return 2 * x


print(twice.ctypes(21))


@njit(parallel=True)
def added(a):
    total = 0.0
    for i in prange(len(a)):
        total += a[i]
    return total


print(added(np.ones(100)))


@njit
def length(x):
    with objmode(found="int64"):
        found = len(str(x))
    return found + 0


print(length(12345))


@njit
def counted(n):
    found = Dict.empty(int64, int64)
    for i in range(n):
        found[i % 3] = found.get(i % 3, 0) + 1
    return found[0]


print(counted(10))

Large = namedtuple("Large", [f"array_{i}" for i in range(20)])


@njit
def returned(large):
    return large.array_3[0, 0], large


print(returned(Large(*[np.ones((2, 2))] * 20))[0])

assert clock() - read > 0.99 * (time.perf_counter() - began), "the clock stood still for what others compile"
assert gc.get_threshold() == thresholds
