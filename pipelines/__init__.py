"""Command-line entry points: thin Hydra applications over `lmd`."""

import signal
import sys
from pathlib import Path

# Where this process is one of the applications (python's -m has not named it yet), a signal is heard from here on.
if sys.argv[:1] == ["-m"] or Path(*sys.argv[:1]).name.startswith("lmd-"):
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # no traceback while what hears it is imported

    from .operations.signals import stop

    stop.listen()
