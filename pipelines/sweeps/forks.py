"""Jobs as processes forked from one that has imported already what they need: importing takes longer than a small job.

The server is started by the first job, with the environment that jobs share: some packages read theirs when they are
imported. It runs nothing itself, so nothing of one job reaches another, and it ends with the process that started it.
"""

import atexit
import gc
import importlib
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from typing import Any

from ..app import GARBAGE, PACKAGE
from ..signals import SIGNALS, stop

# What all jobs of a sweep need, besides their pipeline.
MODULES = (
    "lmd.accuracy",
    "lmd.objectives.coverage_field",
    "lmd.optimisers.annealing",
    "lmd.plot.convergence",
    "lmd.plot.scene",
    "matplotlib.backends.backend_agg",
    "matplotlib.figure",
    "mpl_toolkits.mplot3d",
    f"{PACKAGE}.tracked_run",
)
TRACKED = ("mlflow.store.tracking.sqlalchemy_store", "sqlalchemy.dialects.sqlite")  # which a store in a file needs
LENGTH = 4  # bytes that give the length of a request
DESCRIPTORS = 16  # that come with a request, at most


class Process:
    """A job's process, like one of `subprocess.Popen`.

    Args:
        stdin: descriptor of the writing end of its standard input.
        reports: descriptor from which the server tells its `pid`, and then its exit `code`.
    """

    def __init__(self, stdin: int, reports: int) -> None:
        self.stdin = os.fdopen(stdin, "wb")
        self._reports = os.fdopen(reports)
        self._told: dict[str, int] = {}

    def wait(self) -> int:
        """Wait for its end; returns the exit code, negative for a signal."""
        code = self._hear("code")
        if code is not None:
            return code
        server.cache_clear()
        if not self._told:  # the server ended before it could begin
            return 1
        self.kill()  # the server was killed, and does not know
        return -signal.SIGKILL

    def kill(self) -> None:
        """Kill it, as soon as it is there."""
        pid = self._hear("pid")
        if pid is not None:
            with suppress(ProcessLookupError):  # it has ended
                os.kill(pid, signal.SIGKILL)

    def close(self) -> None:
        """Close the descriptors."""
        self.stdin.close()
        self._reports.close()

    def _hear(self, name: str) -> int | None:
        """Wait for what the server tells; None if it is gone."""
        while name not in self._told:
            key, _, value = self._reports.readline().partition(" ")
            if not value:
                return None
            self._told[key] = int(value)
        return self._told[name]


@cache
def server(modules: Sequence[str], environment: frozenset[tuple[str, str]]) -> socket.socket:
    """The connection to a server that imports `modules` and lives as long as this process."""
    ours, theirs = socket.socketpair()
    with theirs:
        process = subprocess.Popen(
            [sys.executable, "-m", __name__, str(theirs.fileno()), *modules],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            env=dict(environment),
            pass_fds=(theirs.fileno(),),
            start_new_session=True,
        )
    atexit.register(_end, ours, process)
    return ours


def _end(connection: socket.socket, process: "subprocess.Popen[bytes]") -> None:
    connection.close()
    process.wait()


def start(
    pipeline: str,
    arguments: Sequence[str],
    environment: Mapping[str, str],
    variables: Mapping[str, str],
    output: int,
    kept: Sequence[int],
    tracked: bool,
) -> Process:
    """Begin a job in a session of its own.

    Args:
        pipeline: the module whose `main` does it.
        arguments: of its command line.
        environment: that jobs share.
        variables: of this one besides.
        output: descriptor that gets what it prints.
        kept: descriptors that it keeps open besides.
        tracked: whether it talks to mlflow.
    """
    needed = (pipeline, *MODULES, *(TRACKED if tracked else ())), frozenset(environment.items())
    asked = {"pipeline": pipeline, "arguments": arguments, "variables": variables, "folder": os.getcwd()}
    request = json.dumps(asked).encode()
    (its_stdin, stdin), (reports, its_reports) = os.pipe(), os.pipe()
    process = Process(stdin, reports)
    try:
        descriptors = [its_reports, its_stdin, output, *kept]
        try:
            _ask(server(*needed), request, descriptors)
        except ConnectionError:  # it was killed since the last job
            server.cache_clear()
            _ask(server(*needed), request, descriptors)
    finally:
        os.close(its_stdin)
        os.close(its_reports)
    return process


def _ask(connection: socket.socket, request: bytes, descriptors: Sequence[int]) -> None:
    socket.send_fds(connection, [len(request).to_bytes(LENGTH, "big")], descriptors)
    connection.sendall(request)


def _serve(connection: socket.socket) -> dict[str, Any] | None:
    """Fork for each request; returns what is asked in the process that is to do it, and None when no more can come."""
    while True:
        length, descriptors, *_ = socket.recv_fds(connection, LENGTH, DESCRIPTORS)
        if not length:
            return None
        request = connection.recv(int.from_bytes(length, "big"), socket.MSG_WAITALL)
        reports, stdin, output, *_ = descriptors
        pid = os.fork()
        if not pid:
            connection.close()
            os.setsid()
            for descriptor, standard in ((stdin, 0), (output, 1), (output, 2)):
                os.dup2(descriptor, standard)
            for descriptor in (reports, stdin, output):
                os.close(descriptor)
            return dict(json.loads(request))
        for descriptor in descriptors[1:]:
            os.close(descriptor)
        with suppress(BrokenPipeError), os.fdopen(reports, "wb", buffering=0) as told:  # whoever asked may be gone
            told.write(f"pid {pid}\n".encode())
            _, status = os.waitpid(pid, 0)
            told.write(f"code {os.waitstatus_to_exitcode(status)}\n".encode())


def main() -> None:
    """Import what the command line names after a descriptor of the connection, and serve."""
    # What reaches all processes of a SLURM job is for the one that started this.
    before = {number: signal.signal(number, signal.SIG_IGN) for number in (*SIGNALS, signal.SIGUSR2)}
    descriptor, *modules = sys.argv[1:]
    gc.set_threshold(GARBAGE)
    for module in modules:
        importlib.import_module(module)
    from lmd.compiled import load_compiler

    load_compiler()
    gc.freeze()  # what jobs share stays shared: nobody looks for garbage in it
    request = _serve(socket.socket(fileno=int(descriptor)))
    if request is None:
        return
    for number, handler in before.items():
        signal.signal(number, handler)
    pipeline = importlib.import_module(request["pipeline"])
    sys.argv = [str(pipeline.__file__), *request["arguments"]]
    os.environ.update(request["variables"])
    os.chdir(request["folder"])
    stop.listen()
    pipeline.main()


if __name__ == "__main__":
    main()
