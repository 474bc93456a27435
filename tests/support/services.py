"""A service that tests start for themselves, on the loopback."""

import os
import socket
import sys
import time
import urllib.request
from contextlib import contextmanager

import pytest

from support.processes import ROOT, start


def wait_until(ready, process, report):
    """Wait until `ready()` is true, no longer than `process` lives.

    Args:
        ready: what it raises is why it is not.
        process: the process that gets ready.
        report: what else may tell why.
    """
    deadline, latest = time.monotonic() + 120, None
    while time.monotonic() < deadline:
        assert process.poll() is None, report()
        try:
            if ready():
                return
        except Exception as error:
            latest = error
        time.sleep(0.2)
    raise TimeoutError(f"{latest}\n{report()}")


@contextmanager
def mlflow_server(store, home, further=()):
    """The address of an mlflow server that keeps its runs in `store`, as docs/sweeps.md starts it, in one process.

    Args:
        store: address of the database.
        home: folder of the server.
        further: arguments of the command.
    """
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    arguments = [
        "server", "--backend-store-uri", store, "--artifacts-destination", str(home),
        "--host", "127.0.0.1", "--port", str(port), "--workers", "1",
        "--uvicorn-opts", "--timeout-worker-healthcheck 60",  # on a machine that is busy, five seconds are not enough
        *further,
    ]  # fmt: skip
    address, log = f"http://127.0.0.1:{port}", home / "log"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MLFLOW_SERVER_ENABLE_JOB_EXECUTION", "false")  # four more processes for jobs of its own
        line = [sys.executable, "-m", "support.services", *arguments]
        with log.open("w") as output:
            process = start(line, cwd=home, folders=[ROOT / "tests"], stdout=output.fileno(), stderr=output.fileno())
        try:
            wait_until(lambda: urllib.request.urlopen(f"{address}/health").status == 200, process, log.read_text)
            yield address
        finally:
            process.terminate()
            process.wait(timeout=60)


def _become(command, extra_env, **_):
    """Do what the command of uvicorn does, to its end."""
    import uvicorn

    os.environ.update(extra_env)
    sys.argv = command[2:]
    uvicorn.main()


def main():
    """`mlflow server` with one worker, which answers in this process: mlflow would start another that imports much."""
    import mlflow.server
    from mlflow.cli import cli

    mlflow.server._exec_cmd = _become
    sys.argv[0] = "mlflow"
    cli()
