"""Pipelines as a user starts them: processes of their own.

To start Python and to import takes longer than most of what is tested. So pipelines are forked from one process that
has done that (`warm`), unless the start itself matters (`fresh`).
"""

import atexit
import importlib
import io
import json
import logging
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import redirect_stderr, redirect_stdout
from multiprocessing import forkserver, resource_tracker
from pathlib import Path

import pytest
from hydra.core.hydra_config import HydraConfig

from pipelines.operations.signals import stop
from pipelines.operations.sweeps.forks import Descriptor, context, run_module
from support import composing  # noqa: F401 # commands in this process compose their configuration sooner

ROOT = Path(__file__).parents[2]
SMALL = ("room.spacing=1.5", "objective.thold_p=0.5", "validate=false", "picture=false")
LIMIT = 120  # seconds that a test waits for a process
WHOLE = 5 * LIMIT  # for one that runs to its end, and may compile before, on a machine that does other things


def environment(*folders):
    """Where Python finds the pipelines, and what else lies in `folders`."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (ROOT, *folders)))}


def command(pipeline, *overrides, settings=SMALL):
    return [sys.executable, "-m", f"pipelines.{pipeline}", *settings, *overrides]


def call(pipeline, *overrides, cwd, settings=SMALL, folders=(), fresh=False):
    """Run a pipeline to its end, whatever that is."""
    line = command(pipeline, *overrides, settings=settings)
    process = start(line, cwd=cwd, folders=folders, fresh=fresh, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    out, err = process.communicate(timeout=WHOLE)
    return subprocess.CompletedProcess(line, process.returncode, out, err)


def inside(pipeline, *overrides, cwd, settings=SMALL):
    """Run a pipeline to its end in this process; returns as `call`. Sweeps need a process of their own."""
    module = importlib.import_module(f"pipelines.{pipeline}")
    out, err, code = io.StringIO(), io.StringIO(), 0
    handlers = logging.getLogger().handlers[:]
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.chdir(cwd)
        patch.setattr(sys, "argv", [str(module.__file__), *settings, *map(str, overrides)])
        patch.setattr(HydraConfig.instance(), "cfg", None)
        try:
            module.main()
        except SystemExit as ended:
            code = ended.code or 0
        finally:
            logging.getLogger().handlers[:] = handlers  # Hydra's write to the folder of the run
    if isinstance(code, str):  # as Python ends
        err.write(f"{code}\n")
        code = 1
    return subprocess.CompletedProcess(sys.argv, code, out.getvalue(), err.getvalue())


def refused(pipeline, *overrides, message, cwd, settings=SMALL):
    """Run a pipeline, in this process, that prints one sentence on its bad input and leaves no file."""
    before = sorted(cwd.iterdir())
    done = inside(pipeline, *overrides, cwd=cwd, settings=settings)
    assert done.returncode == 1
    lines = done.stderr.splitlines()
    (sentence,) = (line for line in lines if not (line.startswith("compiling ") or line.endswith(" ...")))
    assert sentence.startswith("error: ")
    assert message in sentence, sentence
    assert sorted(cwd.iterdir()) == before


def hearing():
    """Hear signals as a process in the foreground does, whatever this one was made to ignore."""
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM, signal.SIGPIPE):
        signal.signal(number, signal.SIG_DFL)


def start(line, *, cwd, folders=(), fresh=False, ignoring=(), **streams):
    """Start a command and go on.

    Args:
        line: of `command`, or any other.
        cwd: its folder.
        folders: where it finds modules of the test.
        fresh: a process that has imported nothing; so is that of any other command.
        ignoring: signals that it is made to ignore.
        streams: of `subprocess.Popen`.
    """

    def before():
        hearing()
        for number in ignoring:
            signal.signal(number, signal.SIG_IGN)

    if fresh or line[:2] != [sys.executable, "-m"]:
        return subprocess.Popen(line, cwd=cwd, env=environment(*folders), text=True, preexec_fn=before, **streams)
    return Forked(line[2], list(map(str, line[3:])), cwd, environment(*folders), ignoring, **streams)


def ensure_warm():
    """Let processes of this one's fork server come from one that is warm; returns that server's address."""
    server = forkserver._forkserver
    with pytest.MonkeyPatch.context() as patch:  # where it finds its modules
        patch.setenv("PYTHONPATH", os.pathsep.join(map(str, (ROOT, ROOT / "tests"))))
        context.set_forkserver_preload(["support.warm"])
        server.ensure_running()
    return server._forkserver_address


def use_server(address):
    """Let processes of this one come from the fork server at `address`, which another process keeps running."""
    server = forkserver._forkserver
    server._forkserver_address = address
    server._forkserver_alive_fd = os.open(os.devnull, os.O_RDONLY)
    server.ensure_running = resource_tracker.ensure_running


class Forked:
    """A pipeline in a process forked from a warm one, with what tests use of `subprocess.Popen`."""

    def __init__(
        self, module, arguments, cwd, environ, ignoring, start_new_session=False, stdin=None, stdout=None, stderr=None
    ):
        ends = {0: stdin, 1: stdout, 2: stderr}
        pipes = {number: os.pipe() for number, end in ends.items() if end == subprocess.PIPE}
        given = {number: end for number, end in ends.items() if isinstance(end, int) and end >= 0}
        streams = {number: Descriptor(end) for number, end in given.items()}
        streams |= {number: Descriptor(writing) for number, (_, writing) in pipes.items()}
        heard, hears = os.pipe()
        asked = (module, arguments, str(cwd), environ, tuple(ignoring), streams, start_new_session, Descriptor(hears))
        self._process = context.Process(target=_run, args=asked)
        ensure_warm()
        self._process.start()
        os.close(hears)
        os.read(heard, 1)  # until it hears signals, which the server does not, or is gone
        os.close(heard)
        for _, writing in pipes.values():
            os.close(writing)
        self._readers = {number: os.fdopen(reading, newline=None) for number, (reading, _) in pipes.items()}
        self.stdout, self.stderr = self._readers.get(1), self._readers.get(2)
        self.pid = self._process.pid

    def poll(self):
        return self._process.exitcode

    @property
    def returncode(self):
        return self._process.exitcode

    def wait(self, timeout=None):
        self._process.join(timeout)
        if self._process.exitcode is None:
            raise subprocess.TimeoutExpired(self._process.name, timeout)
        return self._process.exitcode

    def communicate(self, timeout=None):
        """Wait for the end of the process; return its output that was not read before."""
        texts = {1: None, 2: None}

        def read(number):
            texts[number] = self._readers[number].read()

        threads = [threading.Thread(target=read, args=[number], daemon=True) for number in self._readers]
        for thread in threads:
            thread.start()
        self.wait(timeout)
        for thread in threads:
            thread.join(timeout)
        return texts[1], texts[2]

    def send_signal(self, number):
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self):
        self.send_signal(signal.SIGKILL)

    def terminate(self):
        self.send_signal(signal.SIGTERM)


def _run(module, arguments, folder, environ, ignoring, streams, leads, hears):
    """Do in the forked process what `python -m module` does."""
    atexit._clear()  # what the server would do at its end, such as removing a folder that others use, is not for this
    assert "support.warm" in sys.modules, "the server could not import it"
    # What it starts comes from the server that it came from, where Python would start another.
    forkserver._forkserver.ensure_running = resource_tracker.ensure_running
    if leads:
        os.setsid()
    hearing()
    for number in ignoring:
        signal.signal(number, signal.SIG_IGN)
    stop.listen()
    os.write(hears, b"1")
    os.close(hears)
    os.chdir(folder)
    sys.path[:0] = [folder, *environ["PYTHONPATH"].split(os.pathsep)]
    try:
        run_module(module, arguments, environ, streams)
    finally:
        threading._shutdown()
        atexit._run_exitfuncs()


SETTINGS = ("optimiser=ega", "deployment.count=40", "tracking.uri=sqlite:///store.db")
ENDLESS = ("budget.evaluations=100000000", "checkpoint_seconds=0.2", "threads=1", "hydra.run.dir=run")


def wait_for(path, process):
    deadline = time.monotonic() + WHOLE
    while not path.exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)


def ended(process):
    """Exit code, stdout and stderr of a process; there is no traceback among it."""
    out, err = process.communicate(timeout=WHOLE)
    assert "Traceback" not in err, err
    return process.returncode, out, err


def runs(cwd):
    from mlflow import MlflowClient  # takes a second to import

    return MlflowClient(tracking_uri=f"sqlite:///{cwd}/store.db").search_runs(["1"], order_by=["start_time"])


def metrics_in(folder):
    return json.loads((folder / "metrics.json").read_text())
