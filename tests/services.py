"""Servers that tests start for real, on ports of their own."""

import socket
import subprocess
import sys
import time
import urllib.request
from contextlib import contextmanager


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_until(ready, process, log):
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        assert process.poll() is None, log.read_text()
        try:
            if ready():
                return
        except Exception as error:
            latest = error
        time.sleep(0.2)
    raise TimeoutError(f"{latest}\n{log.read_text()}")


@contextmanager
def mlflow_server(database, home):
    """The address of an mlflow server that keeps runs in `database` and files in `home`, as docs/sweeps.md says."""
    port, log = free_port(), home / "server.log"
    command = [
        sys.executable, "-m", "mlflow", "server", "--backend-store-uri", database, "--artifacts-destination", home,
        "--host", "127.0.0.1", "--port", str(port), "--workers", "2",
    ]  # fmt: skip
    with log.open("w") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, cwd=home)
    address = f"http://127.0.0.1:{port}"
    try:
        wait_until(lambda: urllib.request.urlopen(f"{address}/health").status == 200, process, log)
        yield address
    finally:
        process.terminate()
        process.wait(timeout=60)
