"""Kernels as plain Python, for a debugger or for coverage: `NUMBA_DISABLE_JIT=1`."""

import json

import pytest
from processes import call

SETTINGS = ("budget.evaluations=3", "room.spacing=2", "validate=false", "picture=false", "tracking=none")


def found_in(folder):
    """All that a run says of what it found; without the time that it took."""
    folder.mkdir()
    done = call("optimise", "hydra.run.dir=run", cwd=folder, settings=SETTINGS, fresh=True)
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr
    run = folder / "run"
    metrics = json.loads((run / "metrics.json").read_text())
    del metrics["wall_time"]
    history = [line.rpartition(",")[0] for line in (run / "history.csv").read_text().splitlines()]
    return (run / "landmarks.csv").read_bytes(), metrics, history


@pytest.mark.slow
def test_kernels_as_plain_python_find_the_same_to_the_bit(tmp_path, monkeypatch):
    """30 s of processor time: the walk of 90 landmarks, uncompiled."""
    compiled = found_in(tmp_path / "compiled")
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    assert found_in(tmp_path / "python") == compiled
