import subprocess

import pytest
from support.processes import ENDLESS, SETTINGS, command, start, wait_for


@pytest.fixture(scope="module")
def uri(tmp_path_factory):
    return f"sqlite:///{tmp_path_factory.mktemp('store')}/mlflow.db"


@pytest.fixture(name="folder")
def _folder(tmp_path, monkeypatch):
    """The folder of the runs that a test starts, which do not say where theirs is."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(name="begin")
def _begin():
    """A function that starts a command; what still runs at the end of the test is killed."""
    processes = []

    def begin(line, cwd, **options):
        processes.append(start(line, cwd=cwd, **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}))
        return processes[-1]

    yield begin
    for process in processes:
        if process.poll() is None:
            process.kill()
            process.wait(timeout=60)


@pytest.fixture(name="endless")
def _endless(begin, tmp_path):
    """A function that starts a run which goes on for ever, and waits until it has written a checkpoint."""

    def endless(*overrides, settings=SETTINGS, cwd=tmp_path, line=(), **options):
        process = begin([*line, *command("optimise", *settings, *ENDLESS, *overrides)], cwd, **options)
        wait_for(cwd / "run" / "checkpoint.npz", process)
        return process

    return endless
