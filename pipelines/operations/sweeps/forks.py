"""Jobs as processes that are forked from Python's fork server.

The fork server has already imported the modules that jobs need (`ready`).
"""

import importlib
import multiprocessing
import os
import signal
import sys
from collections.abc import Iterable, Mapping
from multiprocessing.context import ForkServerProcess
from multiprocessing.reduction import DupFd
from operator import methodcaller
from typing import Any

from ..signals import stop

READY_MODULE = f"{__package__}.ready"
TRACKED = ("mlflow.tracking.client", "mlflow.store.tracking.sqlalchemy_store", "sqlalchemy.dialects.sqlite")

context = multiprocessing.get_context("forkserver")


class Descriptor:
    """File descriptor of this process that is passed to a process forked from the fork server."""

    def __init__(self, number: int) -> None:
        self._number = number

    def __reduce__(self) -> tuple[Any, ...]:
        return methodcaller("detach"), (DupFd(self._number),)


def process(
    pipeline: str, arguments: list[str], environment: dict[str, str], streams: Mapping[int, int], kept: Iterable[int]
) -> ForkServerProcess:
    """Return the process of a job, not yet started, which will run in a session of its own.

    The first process to start waits until the fork server has imported the module `ready`.

    Args:
        pipeline: module whose `main` is called.
        arguments: arguments of the command line.
        environment: environment variables of the job. A package that reads variables when the server imports it has
            read the server's variables instead.
        streams: descriptors that become the job's standard streams, keyed by the numbers 0, 1 and 2 of these streams.
        kept: further descriptors that stay open in the job.
    """
    multiprocessing.set_start_method("forkserver", force=True)  # workers of joblib use another start method
    context.set_forkserver_preload([*TRACKED, READY_MODULE])
    handed = {number: Descriptor(each) for number, each in streams.items()}
    return context.Process(target=_do, args=(pipeline, arguments, environment, handed, list(map(Descriptor, kept))))


def _do(
    pipeline: str, arguments: list[str], environment: dict[str, str], streams: dict[int, int], _kept: list[int]
) -> None:
    """Run a job in a process that was forked from the fork server, with the arguments of `process`."""
    ready = sys.modules.get(READY_MODULE)
    for number, handler in (ready.BEFORE if ready else {}).items():
        signal.signal(number, handler)
    os.setsid()
    run_module(pipeline, arguments, environment, streams)


def run_module(pipeline: str, arguments: list[str], environment: dict[str, str], streams: dict[int, int]) -> None:
    """Run a module in a process that was forked from the fork server, as `python -m` would run it.

    Args:
        pipeline: name of the module.
        arguments: arguments of the command line.
        environment: environment variables of the job; variables that imported modules have set are kept.
        streams: descriptors that become the job's standard streams, keyed by the numbers 0, 1 and 2 of these streams.
    """
    for number, descriptor in streams.items():
        os.dup2(descriptor, number)
    for descriptor in streams.values():
        os.close(descriptor)
    if 0 in streams:
        sys.stdin = os.fdopen(0, closefd=False)  # multiprocessing leaves no standard input
    os.environ.update(environment)
    module: Any = importlib.import_module(pipeline)
    sys.argv = [str(module.__file__), *arguments]
    stop.listen()
    module.main()
