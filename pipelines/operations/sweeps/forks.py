"""Jobs as processes forked from Python's fork server, which has already imported the modules of jobs (`ready`)."""

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
    """File descriptor that is passed to a process of the server."""

    def __init__(self, number: int) -> None:
        self._number = number

    def __reduce__(self) -> tuple[Any, ...]:
        return methodcaller("detach"), (DupFd(self._number),)


def process(
    pipeline: str, arguments: list[str], environment: dict[str, str], streams: Mapping[int, int], kept: Iterable[int]
) -> ForkServerProcess:
    """Make the process of a job, in its own session; the first process waits until the server has imported `ready`.

    Args:
        pipeline: module whose `main` is called.
        arguments: arguments of its command line.
        environment: environment variables; packages that the server has imported may have read the server's variables.
        streams: descriptors that become 0, 1 and 2.
        kept: further descriptors that stay open.
    """
    multiprocessing.set_start_method("forkserver", force=True)  # workers of joblib use another start method
    context.set_forkserver_preload([*TRACKED, READY_MODULE])
    handed = {number: Descriptor(each) for number, each in streams.items()}
    return context.Process(target=_do, args=(pipeline, arguments, environment, handed, list(map(Descriptor, kept))))


def _do(
    pipeline: str, arguments: list[str], environment: dict[str, str], streams: dict[int, int], _kept: list[int]
) -> None:
    """Run a job within a process of the server."""
    ready = sys.modules.get(READY_MODULE)
    for number, handler in (ready.BEFORE if ready else {}).items():
        signal.signal(number, handler)
    os.setsid()
    run_module(pipeline, arguments, environment, streams)


def run_module(pipeline: str, arguments: list[str], environment: dict[str, str], streams: dict[int, int]) -> None:
    """Run a module in a process of the server, as `python -m` would.

    Args:
        pipeline: the module.
        arguments: arguments of its command line.
        environment: environment variables; variables that imported modules have set stay.
        streams: descriptors that become 0, 1 and 2.
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
