"""Modules that a sweep's fork server imports before the first job; only the fork server imports this module.

The imports take longer than a small job. The server itself runs no job, so that jobs share no state.
"""

import gc
import importlib
import signal

from lmd.core.compiled import load_compiler

from ... import GARBAGE
from ...app import PACKAGE
from ..signals import SIGNALS

# A terminal signals all processes; only the process that started this server handles the signals.
BEFORE = {number: signal.signal(number, signal.SIG_IGN) for number in SIGNALS}

gc.set_threshold(GARBAGE)
for module in (
    "lmd.evaluation.accuracy", "lmd.incremental.coverage_field", "lmd.optimisers.annealing", "lmd.plot.charts",
    "lmd.plot.scenes", "matplotlib.backends.backend_agg", "matplotlib.figure", "mpl_toolkits.mplot3d",
    f"{PACKAGE}.progress",
):  # fmt: skip
    importlib.import_module(module)
load_compiler()
gc.freeze()  # garbage collection would copy the memory shared by the jobs
