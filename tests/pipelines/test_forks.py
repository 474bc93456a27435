import json
import os
import signal
import subprocess
import sys

import pytest
from processes import LIMIT, ensure_warm, environment, start

from pipelines.operations.sweeps import forks

pytestmark = pytest.mark.slow

PROBE = """
import json, os, sys, time

TRIES = "MLFLOW_HTTP_REQUEST_MAX_RETRIES"
seen = []  # of the jobs before, if they shared anything

def main():
    seen.append(sys.argv[1])
    told = {"seen": seen, "own": os.environ.get("OWN"), "leads": os.getsid(0) == os.getpid(), "folder": os.getcwd(),
            "tries": os.environ.get(TRIES)}
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
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    ensure_warm()

    def begun(name, code=0, **own):
        with (tmp_path / name).open("wb") as output:
            process = forks.Process("probe", [name, str(code)], environment() | own, output.fileno())
            process.start()
            return process

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


def test_what_modules_set_when_the_server_imported_them_stays(begin, tmp_path, monkeypatch):
    monkeypatch.delenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", raising=False)
    assert begin("bare").wait() == 0
    assert json.loads((tmp_path / "bare").read_text())["tries"] == "2"  # or a server that is gone is tried for minutes


def test_a_job_ends_when_it_is_told_or_killed(begin):
    told = begin("wait")
    told.stdin.close()
    assert told.wait() == 0
    killed = begin("wait")
    killed.kill()
    assert killed.wait() == -signal.SIGKILL


def test_a_job_that_nobody_waits_for_any_more_ends_and_the_server_goes_on(begin, tmp_path):
    left = begin("wait")
    left.close()
    left.wait()
    assert begin("after").wait() == 0
    left, after = (json.loads((tmp_path / name).read_text())["server"] for name in ("wait", "after"))
    assert left == after


KILLS = """
import json, os, signal, sys
from pipelines.operations.sweeps import forks

def begin(name):
    with open(name, "wb") as output:
        process = forks.Process("probe", [name, "0"], os.environ, output.fileno())
        process.start()
        return process

def server(name):
    return json.load(open(name))["server"]

assert begin("before").wait() == 0
job = begin("wait")
os.kill(server("before"), signal.SIGKILL)
assert job.wait() == -signal.SIGKILL
assert begin("after").wait() == 0
assert server("after") != server("before")
os.kill(server("after"), signal.SIGKILL)
while os.waitid(os.P_PID, server("after"), os.WEXITED | os.WNOWAIT) is None:
    pass
assert begin("later").wait() == 0
"""


@pytest.mark.thorough("pipelines/operations/sweeps/forks.py")
def test_where_the_server_is_killed_the_next_job_gets_another(tmp_path):
    (tmp_path / "probe.py").write_text(PROBE)
    line = [sys.executable, "-c", KILLS]
    done = start(line, cwd=tmp_path, folders=[tmp_path], stderr=subprocess.PIPE)
    assert (done.communicate(timeout=LIMIT)[1], done.returncode) == ("", 0)
