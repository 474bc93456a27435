import json
import os
import signal

import pytest

from pipelines.sweeps import forks
from tests.processes import environment

pytestmark = pytest.mark.slow

PROBE = """
import json, os, sys, time

seen = []  # of the jobs before, if they shared anything

def main():
    seen.append(sys.argv[1])
    told = {"seen": seen, "own": os.environ.get("OWN"), "leads": os.getsid(0) == os.getpid(), "folder": os.getcwd()}
    print(json.dumps(told | {"server": os.getppid()}), flush=True)
    if sys.argv[1] == "wait":
        sys.stdin.read()
    if sys.argv[1] == "kill":
        os.kill(os.getpid(), 9)
    sys.exit(int(sys.argv[2]))
"""


@pytest.fixture
def begin(tmp_path, monkeypatch):
    """Begins a job that prints to the file of its name."""
    (tmp_path / "probe.py").write_text(PROBE)
    monkeypatch.setattr(forks, "MODULES", ())
    monkeypatch.chdir(tmp_path)
    shared = {name: value for name, value in environment(tmp_path).items() if name != "OWN"}

    def begun(name, code=0, **own):
        with (tmp_path / name).open("wb") as output:
            return forks.start("probe", [name, str(code)], shared, own, output.fileno(), (), tracked=False)

    return begun


def test_jobs_share_a_server_and_nothing_else(begin, tmp_path):
    codes = [begin("one", 3, OWN="1").wait(), begin("kill").wait(), begin("two").wait()]
    assert codes == [3, -signal.SIGKILL, 0]
    one, killed, two = (json.loads((tmp_path / name).read_text()) for name in ("one", "kill", "two"))
    assert one["server"] == killed["server"] == two["server"] != os.getpid()
    assert (one["seen"], two["seen"]) == (["one"], ["two"])
    assert (one["own"], two["own"]) == ("1", None)
    assert one["leads"]
    assert one["folder"] == str(tmp_path)


def test_a_job_ends_when_it_is_told_or_killed(begin):
    told = begin("wait")
    told.stdin.close()
    assert told.wait() == 0
    killed = begin("wait")
    killed.kill()
    assert killed.wait() == -signal.SIGKILL


def test_a_job_that_nobody_waits_for_any_more_ends_and_the_server_goes_on(begin, tmp_path):
    begin("wait").close()
    assert begin("after").wait() == 0
    left, after = (json.loads((tmp_path / name).read_text())["server"] for name in ("wait", "after"))
    assert left == after


def test_where_the_server_is_killed_the_next_job_gets_another(begin, tmp_path):
    assert begin("before").wait() == 0
    job = begin("wait")
    os.kill(json.loads((tmp_path / "before").read_text())["server"], signal.SIGKILL)
    assert job.wait() in (1, -signal.SIGKILL)  # not begun yet, or begun
    assert begin("after").wait() == 0
    idle = json.loads((tmp_path / "after").read_text())["server"]
    os.kill(idle, signal.SIGKILL)
    os.waitpid(idle, 0)
    assert begin("later").wait() == 0
