"""Pipelines as a user starts them: processes of their own."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
SMALL = ("room.spacing=1.5", "objective.thold_p=0.5", "validate=false")


def environment(*folders):
    """Where Python finds the pipelines, and what else lies in `folders`."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (ROOT, *folders)))}


def command(pipeline, *overrides, settings=SMALL):
    return [sys.executable, "-m", f"pipelines.{pipeline}", *settings, *overrides]


def call(pipeline, *overrides, cwd, settings=SMALL, folders=()):
    """Run a pipeline to its end, whatever that is."""
    line = command(pipeline, *overrides, settings=settings)
    environ = environment(*folders)
    return subprocess.run(line, cwd=cwd, env=environ, capture_output=True, text=True, check=False)


def refused(pipeline, *overrides, message, cwd, settings=SMALL):
    """Run a pipeline that tells in one sentence why it does not, and leaves nothing."""
    before = sorted(cwd.iterdir())
    done = call(pipeline, *overrides, cwd=cwd, settings=settings)
    assert done.returncode == 1
    assert done.stderr.startswith("error: ")
    assert message in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert sorted(cwd.iterdir()) == before


def help_of(pipeline, *slow, cwd):
    """What `--help` prints, followed by the list of those of the `slow` packages that it loaded."""
    return loading(pipeline, "--help", slow=slow, cwd=cwd)


def loading(pipeline, *arguments, slow, cwd):
    """What a command prints, followed by the list of those of the `slow` packages that it loaded."""
    code = f"""
import sys
from pipelines.{pipeline} import main
sys.argv = {[pipeline, *arguments]}
try:
    main()
finally:
    print([name for name in {slow} if name in sys.modules])
"""
    line = [sys.executable, "-c", code]
    return subprocess.run(line, cwd=cwd, env=environment(), capture_output=True, text=True, check=False).stdout


def start(line, *, cwd, folders=(), **streams):
    """Start a command and go on."""
    return subprocess.Popen(line, cwd=cwd, env=environment(*folders), text=True, **streams)
