"""Runs with a full disk or a tracking server that dies: their files and messages."""

import contextlib
import json
import re
import signal
import subprocess
import time

import pandas as pd
import pytest
from mlflow import MlflowClient
from support.processes import SETTINGS, call, ended, metrics_in
from support.services import mlflow_server

pytestmark = pytest.mark.slow


@contextlib.contextmanager
def small_disk(path, size):
    path.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", path], check=False).returncode:
        pytest.skip("a small disk can only be mounted by root")
    try:
        yield path
    finally:
        subprocess.run(["umount", "--lazy", path], check=True)


def test_on_a_disk_that_fills_up_landmarks_and_figures_are_kept(endless, tmp_path):
    with small_disk(tmp_path / "disk", "2m") as disk:
        settings = (*SETTINGS[:2], "picture=true", "tracking.uri=sqlite:///../store.db")
        process = endless(settings=settings, cwd=disk)
        with contextlib.suppress(OSError), (disk / "filler").open("wb", buffering=0) as filler:
            for size in (1 << 16, 1 << 10, 1):
                with contextlib.suppress(OSError):
                    while True:
                        filler.write(bytes(size))
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        code, out, err = ended(process)
        assert code == 130
        assert "warning: no checkpoint can be written (No space left on device); the run goes on" in err
        assert "scene.png could not be written (No space left on device)" in err
        assert f"python -m pipelines.evaluate run={disk / 'run'}" in err
        assert len(pd.read_csv(disk / "run" / "landmarks.csv")) == 40
        assert metrics_in(disk / "run")["stopped"] == "interrupted"
        assert "qualified ratio" in out
        (disk / "filler").unlink()
        assert json.loads((disk / "run" / "metrics.json").read_text())["evaluations"] > 1
        done = call("optimise", *settings, "resume=run", "budget.evaluations=1", "hydra.run.dir=run", cwd=disk)
        assert done.returncode == 0, done.stderr


def test_a_disk_that_is_full_from_the_start_is_one_sentence(tmp_path):
    with small_disk(tmp_path / "disk", "64k") as disk:
        done = call("optimise", *SETTINGS[:2], "tracking=none", "hydra.run.dir=run", cwd=disk)
        assert done.returncode == 1
        assert re.fullmatch(r"error: .*/disk/run: no space is left .*\n", done.stderr), done.stderr
        assert not list(disk.iterdir())


@pytest.mark.thorough("pipelines/operations/tracking", "pipelines/runs.py")
def test_a_server_that_dies_costs_a_warning_and_gets_everything_later(endless, tmp_path):
    (tmp_path / "server").mkdir()
    database = f"sqlite:///{tmp_path}/server.db"
    with mlflow_server(database, tmp_path / "server") as address:
        run = endless(settings=(*SETTINGS[:2], "picture=true", f"tracking.uri={address}"))
    time.sleep(0.5)
    run.send_signal(signal.SIGINT)
    code, out, err = ended(run)
    assert code == 130
    assert err.count("cannot be used") == 1
    assert len(pd.read_csv(tmp_path / "run" / "landmarks.csv")) == 40
    (sync,) = re.findall(r"python -m pipelines\.(runs sync=\S+ tracking\.uri=\S+)", out)
    refused = call(*sync.split(), settings=(), cwd=tmp_path)
    assert refused.returncode == 1
    assert "cannot be used" in refused.stderr
    with mlflow_server(database, tmp_path / "server") as again:
        done = call(*sync.split(), f"tracking.uri={again}", settings=(), cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        client = MlflowClient(tracking_uri=again)
        (kept,) = client.search_runs([client.get_experiment_by_name("lmd").experiment_id])
        assert kept.info.status == "KILLED"
        assert kept.data.metrics["fitness"] == metrics_in(tmp_path / "run")["fitness"]
        files = {file.path for file in client.list_artifacts(kept.info.run_id)}
        assert {"landmarks.csv", "metrics.json", "scene.png"} <= files
    assert "nothing to hand in" in call("runs", "sync=.", settings=(), cwd=tmp_path).stdout
