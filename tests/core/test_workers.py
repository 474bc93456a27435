import os
import signal
import subprocess
import sys

import pytest
from support.processes import ROOT, environment

from lmd.core.checks import InputError
from lmd.core.workers import in_processes

OUTLIVING = """
import os, sys
sys.path.append({folder!r})
from test_workers import wait_for_ever
from lmd.core.workers import in_processes
print(list(in_processes(wait_for_ever, ["worker"] * 2, workers=2, name=str)))
"""


def ignores_interrupts(_job):
    return signal.getsignal(signal.SIGINT) == signal.SIG_IGN


def killed_the_first_time(path):
    """Killed unless the file that it names is there; a number is squared."""
    if isinstance(path, int):
        return path**2
    if not os.path.exists(path):
        with open(path, "w"):
            os.kill(os.getpid(), signal.SIGKILL)
    return "again"


def killed(_job):
    os.kill(os.getpid(), signal.SIGKILL)


def wait_for_ever(pipe):
    with open(pipe, "w") as held:
        print(os.getpid(), file=held, flush=True)
        signal.pause()


@pytest.fixture
def _heard():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may have made this process ignore it
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("_heard")
def test_a_terminal_that_interrupts_the_workers_is_left_to_who_began_them():
    """A worker that raised KeyboardInterrupt would print a traceback."""
    assert list(in_processes(ignores_interrupts, range(3), workers=2, name=str, ordered=True)) == [True] * 3
    assert not ignores_interrupts(0)


def test_what_a_killed_worker_had_in_hand_is_done_again(tmp_path):
    jobs = [1, 2, str(tmp_path / "a"), *range(3, 10)]
    results = list(in_processes(killed_the_first_time, jobs, workers=2, name=str, ordered=True))
    assert results == [1, 4, "again", *(number**2 for number in range(3, 10))]


def test_a_job_whose_worker_is_killed_twice_is_named():
    with pytest.raises(InputError, match=r"^workers: the process that worked on K=40 was killed, even"):
        list(in_processes(killed, ["40", "40"], workers=2, name=lambda job: f"K={job}"))


def test_without_semaphores_a_sentence_says_how_to_go_on(monkeypatch):
    def refuse(*_args):
        raise FileNotFoundError(2, "No such file or directory")

    monkeypatch.setattr("lmd.core.workers.ProcessPoolExecutor", refuse)
    with pytest.raises(
        InputError, match=r"^workers need semaphores of the operating system \(.*No such file.*\); set workers=1"
    ):
        list(in_processes(ignores_interrupts, range(2), workers=2, name=str))


def test_workers_end_with_the_process_that_began_them_however_that_ends(tmp_path):
    pipe = tmp_path / "worker"
    os.mkfifo(pipe)
    code = OUTLIVING.format(folder=str(ROOT / "tests" / "core"))
    line, quiet = [sys.executable, "-c", code], subprocess.DEVNULL
    parent = subprocess.Popen(line, cwd=tmp_path, env=environment(ROOT / "tests"), stderr=quiet)
    with pipe.open() as workers:
        assert {workers.readline(), workers.readline()} - {""}
        parent.kill()
        parent.wait()
        workers.read()  # ends when nobody holds the other end
