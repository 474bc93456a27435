"""Compare all attributes of numba and llvmlite before and after `lmd` is used; prints what has changed."""

import contextlib
import importlib
import pkgutil
import sys
import types

import numba
import numba.core
import numba.experimental
import numba.typed
from llvmlite.binding.ffi import lib
from numba.core import datamodel, event

FIXED = types.FunctionType, types.BuiltinFunctionType, type, property, classmethod, staticmethod


def attributes():
    """All attributes of the modules and classes of numba and llvmlite that are functions, methods or classes."""
    owners = {name: module for name, module in sys.modules.items() if name.partition(".")[0] in ("numba", "llvmlite")}
    for name, module in list(owners.items()):
        classes = {key: value for key, value in vars(module).items() if isinstance(value, type)}
        owners |= {f"{name}.{key}": value for key, value in classes.items() if value.__module__ == name}
    values = {(name, key): value for name, owner in owners.items() for key, value in list(vars(owner).items())}
    return {place: value for place, value in values.items() if isinstance(value, FIXED)}


def registries():
    """The models of data, the listeners to events, and those to llvmlite's lock."""
    listeners = {kind: list(heard) for kind, heard in event._registered.items() if heard}
    return dict(datamodel.default_manager._handlers), listeners, list(lib._lock._cblist)


for package in (numba.core, numba.np, numba.cpython, numba.experimental, numba.typed):
    for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        with contextlib.suppress(ImportError):  # of another platform
            importlib.import_module(found.name)
numba.njit(lambda a, b: a + b)((1, 2.0), (2,))  # numba itself sets some with the first function
before, (models, *listening) = attributes(), registries()
assert len(before) > 10_000

importlib.import_module("used")
after, (models_after, *listening_after) = attributes(), registries()
changed = [".".join(place) for place, value in before.items() if after.get(place) is not value]
changed += [f"model of {kind}" for kind, model in models.items() if models_after[kind] is not model]
print("changed:", changed + [f"listeners: {listening_after}"] * (listening != listening_after))
