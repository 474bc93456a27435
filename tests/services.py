"""Services that tests start for themselves, on the loopback."""

import socket
import subprocess
import sys
import time
import urllib.request
from contextlib import contextmanager

import pytest
from processes import ROOT, hearing, start


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_until(ready, process=None, report=lambda: ""):
    """Wait until `ready()` is true, no longer than `process` lives.

    Args:
        ready: what it raises is why it is not.
        process: without it there is nothing to wait for.
        report: what else may tell why.
    """
    deadline, latest = time.monotonic() + 120, None
    while time.monotonic() < deadline:
        assert process is None or process.poll() is None, report()
        try:
            if ready():
                return
        except Exception as error:
            latest = error
        time.sleep(0.2)
    raise TimeoutError(f"{latest}\n{report()}")


@contextmanager
def service(command, ready, log, **options):
    """A process that runs while this is entered, from the moment it is `ready()`."""
    with log.open("w") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, preexec_fn=hearing, **options)
    with _ending(process, ready, log):
        yield


@contextmanager
def _ending(process, ready, log):
    """While this is entered, a process runs that is `ready()`."""
    try:
        wait_until(ready, process, log.read_text)
        yield
    finally:
        process.terminate()
        process.wait(timeout=60)


@contextmanager
def mlflow_server(store, home, further=()):
    """The address of an mlflow server that keeps its runs in `store`, as docs/sweeps.md starts it, in one process.

    Args:
        store: address of the database.
        home: folder of the server.
        further: arguments of the command.
    """
    port = free_port()
    arguments = [
        "server", "--backend-store-uri", store, "--artifacts-destination", str(home),
        "--host", "127.0.0.1", "--port", str(port), "--workers", "1",
        "--uvicorn-opts", "--timeout-worker-healthcheck 60",  # on a machine that is busy, five seconds are not enough
        *further,
    ]  # fmt: skip
    address, log = f"http://127.0.0.1:{port}", home / "log"

    def ready():
        return urllib.request.urlopen(f"{address}/health").status == 200

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MLFLOW_SERVER_ENABLE_JOB_EXECUTION", "false")  # four more processes for jobs of its own
        line = [sys.executable, "-m", "mlflow_in_one", *arguments]
        with log.open("w") as output:
            process = start(line, cwd=home, folders=[ROOT / "tests"], stdout=output.fileno(), stderr=output.fileno())
        with _ending(process, ready, log):
            yield address
