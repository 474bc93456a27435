"""Jobs as processes of Python's fork server, which has imported the jobs' modules (`ready`)."""

import importlib
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from multiprocessing.reduction import DupFd
from typing import Any

from ..signals import stop

READY_MODULE = f"{__package__}.ready"
TRACKED = ("mlflow.store.tracking.sqlalchemy_store", "sqlalchemy.dialects.sqlite")  # modules for a store in a file
SERVED = ("mlflow.tracking.client", "mlflow.store.tracking.rest_store")  # modules for a tracking server
ATTEMPTS = 20  # greatest number of attempts to start a process
PAUSE_SECONDS = 0.05  # time between attempts, seconds
SERVER_DIED = 255  # exit code that Python gives a process whose server has died

context = multiprocessing.get_context("forkserver")


class Process:
    """Process of a job in a session of its own; the process stops when its standard input is closed.

    Args:
        pipeline: module whose `main` is called.
        arguments: arguments of its command line.
        environment: environment variables; packages that the server has imported may have read the server's variables.
        output: descriptor for stdout and stderr.
        kept: further descriptors that stay open.
        store: address of the mlflow store of the job, if any.
    """

    def __init__(
        self, pipeline: str, arguments: Sequence[str], environment: Mapping[str, str], output: int,
        kept: Iterable[int] = (), store: str | None = None,
    ) -> None:  # fmt: skip
        self._its_stdin, stdin = os.pipe()
        self.stdin = os.fdopen(stdin, "wb")
        records = () if store is None else SERVED if store.startswith("http") else TRACKED
        self._preloaded = [*records, READY_MODULE]
        streams = {0: self._its_stdin, 1: output, 2: output}
        self._asked = pipeline, list(arguments), dict(environment), streams, tuple(kept)
        self._process: Any = None

    def start(self) -> None:
        """Start the process; the first call in a process waits until the server has imported the modules of jobs."""
        pipeline, arguments, environment, streams, kept = self._asked
        multiprocessing.set_start_method("forkserver", force=True)  # workers of joblib use another start method
        context.set_forkserver_preload(self._preloaded)
        handed = {number: Descriptor(descriptor) for number, descriptor in streams.items()}
        also = [Descriptor(descriptor) for descriptor in kept]
        for left in reversed(range(ATTEMPTS)):
            begun = context.Process(target=_do, args=(pipeline, arguments, environment, handed, also))
            try:
                begun.start()
            except (EOFError, ConnectionError):  # a server that was just killed still counts as alive
                if not left:
                    raise
                time.sleep(PAUSE_SECONDS)
            else:
                break
        self._process = begun

    def wait(self) -> int:
        """Wait for the end of the process, and return the exit code: negative for a signal, 1 if the process never
        began.
        """
        if self._process is None:
            return 1
        self._process.join()
        code = int(self._process.exitcode)
        if code == SERVER_DIED:
            with suppress(ProcessLookupError):  # the job may outlive its server
                os.kill(self._process.pid, signal.SIGKILL)
                return -signal.SIGKILL
        return code

    def kill(self) -> None:
        """Kill the process."""
        if self._process is not None:
            self._process.kill()

    def close(self) -> None:
        """Close the descriptors."""
        self.stdin.close()
        os.close(self._its_stdin)


class Descriptor:
    """Descriptor that is passed to a process of the server."""

    def __init__(self, number: int) -> None:
        self._number = number

    def __reduce__(self) -> tuple[Any, ...]:
        return _handed_on, (DupFd(self._number),)


def _handed_on(descriptor: Any) -> int:
    return int(descriptor.detach())


def _do(
    pipeline: str, arguments: list[str], environment: dict[str, str], streams: dict[int, int], _kept: list[int]
) -> None:
    """Run a job in the process of the server."""
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
