"""Runs that are told to stop, killed, or left without disk or tracking server: what they leave, and going on."""

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time

import pandas as pd
import pytest
from examples import SHARE
from mlflow import MlflowClient
from processes import ROOT, SMALL, call, command, environment, start
from services import mlflow_server

pytestmark = [pytest.mark.slow, pytest.mark.long]

SETTINGS = ("optimiser=ega", "deployment.count=40", "tracking.uri=sqlite:///store.db")
ENDLESS = ("budget.evaluations=100000000", "checkpoint_seconds=0.2", "hydra.run.dir=run")
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def wait_for(path, process):
    deadline = time.monotonic() + 120
    while not path.exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)


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


def ended(process):
    """Exit code, stdout and stderr of a process; there is no traceback among it."""
    out, err = process.communicate(timeout=120)
    assert "Traceback" not in err, err
    return process.returncode, out, err


def runs(cwd):
    return MlflowClient(tracking_uri=f"sqlite:///{cwd}/store.db").search_runs(["1"], order_by=["start_time"])


def metrics_in(folder):
    return json.loads((folder / "metrics.json").read_text())


@pytest.mark.parametrize("number", SIGNALS)
def test_told_to_stop_it_keeps_the_best_and_says_how_to_go_on(endless, number, tmp_path):
    process = endless()
    process.send_signal(number)
    code, _, err = ended(process)
    assert code == 128 + number
    assert "stopping after this batch" in err
    first = metrics_in(tmp_path / "run")
    assert first["stopped"] == "interrupted"
    assert first["fitness"] == pd.read_csv(tmp_path / "run" / "history.csv").best_fitness.max()
    (run,) = runs(tmp_path)
    assert run.info.status == "KILLED"
    (again,) = re.findall(r"go on with: python -m pipelines\.optimise (.*)", err)
    assert again.endswith(f"resume={tmp_path / 'run'}")
    assert not {".reserve", "tracking.jsonl"} & {path.name for path in (tmp_path / "run").iterdir()}


def test_told_twice_it_stops_at_once_and_keeps_the_best(endless, tmp_path):
    process = endless("validate=true")
    process.send_signal(signal.SIGINT)
    process.send_signal(signal.SIGTERM)
    process.send_signal(signal.SIGINT)
    assert ended(process)[0] in {128 + number for number in SIGNALS}
    assert len(pd.read_csv(tmp_path / "run" / "landmarks.csv")) == 40
    assert 0.0 < metrics_in(tmp_path / "run")["fitness"] <= 1.0
    (run,) = runs(tmp_path)
    assert run.info.status == "KILLED"
    assert run.data.metrics["fitness"] == metrics_in(tmp_path / "run")["fitness"]


@pytest.mark.parametrize(
    ("number", "delay"),
    [
        *((signal.SIGINT, delay) for delay in (0.05, 0.3, 0.8, 1.5, 2.5)),
        *((signal.SIGTERM, delay) for delay in (0.3, 1.5)),
        *((signal.SIGHUP, delay) for delay in (0.8, 2.5)),
    ],
)
def test_told_to_stop_before_there_is_anything_it_leaves_nothing(begin, number, delay, tmp_path):
    process = begin(command("optimise", *SETTINGS, *ENDLESS), tmp_path, fresh=True)
    time.sleep(delay)
    process.send_signal(number)
    _, err = process.communicate(timeout=120)
    # Before it reads our first line, Python has a traceback of its own, and an exit code of its own while it starts.
    assert "Traceback" not in err or f"{ROOT}/pipelines" not in err
    codes = {128 + number, -number} | ({1} if "Traceback" in err and f"{ROOT}/pipelines" not in err else set())
    left = {path.name for path in (tmp_path / "run").iterdir()} if (tmp_path / "run").exists() else set()
    if "checkpoint.npz" not in left:
        assert process.returncode in codes, err
        assert not left or "landmarks.csv" in left
    if (tmp_path / "store.db").exists():
        assert not [run for run in runs(tmp_path) if run.info.status == "RUNNING"]


@pytest.mark.parametrize(
    ("library", "function"),
    [("hydra._internal.config_loader_impl.ConfigLoaderImpl", "load_configuration"), ("pipelines.building", "deepcopy")],
)
def test_told_to_stop_within_a_library_that_fails_of_it_it_says_so_and_no_more(library, function, tmp_path):
    """Hydra while it composes, and OmegaConf while objects are made, are left with a configuration half done."""
    code = f"""
import signal, sys, hydra.core.utils, hydra._internal.config_loader_impl, pipelines.building
from pipelines.optimise import main
from pipelines.operations.signals import stop
def halved(*args, **kwargs):
    try:
        signal.raise_signal(signal.SIGTERM)
    finally:
        raise AttributeError("half done")
{library}.{function} = halved
stop.listen()
sys.argv = {["optimise", *SETTINGS, "hydra.run.dir=run"]}
main()
"""
    line = [sys.executable, "-c", code]
    done = subprocess.run(line, cwd=tmp_path, env=environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 128 + signal.SIGTERM, done.stderr
    assert done.stderr.split("\n\n") == ["\nstopping", "while stopping: AttributeError: half done\n"]
    assert not (tmp_path / "run").exists()


def test_a_closed_terminal_is_no_reason_to_lose_the_result(begin, tmp_path):
    ours, theirs = os.openpty()
    line = command("optimise", *SETTINGS, *ENDLESS, "picture=true")
    terminal = dict.fromkeys(("stdin", "stdout", "stderr"), theirs)
    process = begin(line, tmp_path, start_new_session=True, **terminal)
    os.close(theirs)
    wait_for(tmp_path / "run" / "checkpoint.npz", process)
    os.close(ours)
    process.send_signal(signal.SIGHUP)
    assert process.wait(timeout=120) == 128 + signal.SIGHUP
    assert (tmp_path / "run" / "scene.png").exists()
    (run,) = runs(tmp_path)
    assert run.info.status == "KILLED"


def test_under_nohup_a_closed_terminal_is_ignored(endless):
    process = endless(line=["nohup"])
    process.send_signal(signal.SIGHUP)
    time.sleep(1.0)
    assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    assert ended(process)[0] == 128 + signal.SIGTERM


def test_ctrl_c_reaches_a_run_whose_shell_ignores_it(endless):
    process = endless(ignoring=[signal.SIGINT], fresh=True)
    process.send_signal(signal.SIGINT)
    assert ended(process)[0] == 128 + signal.SIGINT


def test_one_history_stays_one_run_and_another_is_linked_to_it(endless, tmp_path):
    def stopped(*overrides):
        process = endless(*overrides)
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        assert ended(process)[0] == 130

    stopped()
    (tmp_path / "run").rename(tmp_path / "moved")
    (tmp_path / "moved").rename(tmp_path / "run")
    shutil.copytree(tmp_path / "run", tmp_path / "before")
    stopped("resume=run")  # the same settings: goes on
    (run,) = runs(tmp_path)
    client = MlflowClient(tracking_uri=f"sqlite:///{tmp_path}/store.db")
    curve = sorted(client.get_metric_history(run.info.run_id, "best_fitness"), key=lambda point: point.timestamp)
    assert [point.step for point in curve] == sorted(point.step for point in curve)
    assert run.data.metrics["evaluations"] == metrics_in(tmp_path / "run")["evaluations"]
    # Another budget, and a checkpoint that was gone on with already, make another history.
    more = f"budget.evaluations={metrics_in(tmp_path / 'run')['evaluations'] + 58}"
    done = call("optimise", *SETTINGS, more, "resume=run", "hydra.run.dir=run2", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    done = call("optimise", *SETTINGS, more, "resume=before", "hydra.run.dir=run3", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    first, second, third = runs(tmp_path)
    assert [run.info.status for run in (first, second, third)] == ["KILLED", "FINISHED", "FINISHED"]
    assert second.data.tags["continues"] == third.data.tags["continues"] == first.info.run_id
    for run in (second, third):
        steps = [point.step for point in client.get_metric_history(run.info.run_id, "best_fitness")]
        assert min(steps) < 100  # its curve is whole
    refused = call("optimise", *SETTINGS, "resume=run", "objective.n=3", "hydra.run.dir=run4", cwd=tmp_path)
    assert "was made with objective.n = 2, not 3" in refused.stderr


KILLS = max(8, round(24 * SHARE))


TAGS = ("deployment=uniform", "deployment.count=12", "pdf=yaw", "pdf.divisions=3")
IN_TURN = (*TAGS, "rounds=2", "tag_evaluations=1500")
KILLED = [
    ("optimise", KILLS, 40000, (*SETTINGS, "budget.evaluations=40000"), ()),
    ("place_cameras", KILLS // 2, 2 * (200 + 1500), (*IN_TURN, SETTINGS[-1], "budget.evaluations=200"), ("rig.yaml",)),
]


@pytest.mark.parametrize(
    ("pipeline", "kills", "evaluations", "given", "further"), KILLED, ids=[row[0] for row in KILLED]
)
def test_killed_at_random_moments_it_ends_where_it_would_have(pipeline, kills, evaluations, given, further, tmp_path):
    settings = (*SMALL, *given, "threads=1", "checkpoint_seconds=0.05")
    done = call(pipeline, *settings, "hydra.run.dir=whole", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    shutil.rmtree(tmp_path / "run", ignore_errors=True)
    line = [sys.executable, ROOT / "tests" / "killed.py", pipeline, "1", str(kills), *settings]
    done = subprocess.run(
        line, cwd=tmp_path, env=environment(ROOT / "tests"), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, (tmp_path / "log").read_text()
    assert done.stdout.count("killed after a checkpoint") > kills // 3
    for name in ("landmarks.csv", "history.csv"):
        whole, kept = (pd.read_csv(tmp_path / folder / name) for folder in ("whole", "run"))
        pd.testing.assert_frame_equal(*(table.drop(columns="wall_time", errors="ignore") for table in (whole, kept)))
    for name in ("landmarks.csv", *further):
        assert (tmp_path / "run" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert {run.info.status for run in runs(tmp_path)} <= {"FINISHED", "FAILED"}
    finished = runs(tmp_path)[-1]
    assert finished.info.status == "FINISHED"
    client = MlflowClient(tracking_uri=f"sqlite:///{tmp_path}/store.db")
    curve = client.get_metric_history(finished.info.run_id, "best_fitness")
    assert max(point.step for point in curve) == evaluations
    assert not list(tmp_path.rglob("*.partial*"))


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
    (sync,) = re.findall(r"python -m pipelines\.(sync folder=\S+ uri=\S+)", out)
    refused = call(*sync.split(), settings=(), cwd=tmp_path)
    assert refused.returncode == 1
    assert "cannot be used" in refused.stderr
    with mlflow_server(database, tmp_path / "server") as again:
        done = call(*sync.split(), f"uri={again}", settings=(), cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        client = MlflowClient(tracking_uri=again)
        (kept,) = client.search_runs([client.get_experiment_by_name("lmd").experiment_id])
        assert kept.info.status == "KILLED"
        assert kept.data.metrics["fitness"] == metrics_in(tmp_path / "run")["fitness"]
        files = {file.path for file in client.list_artifacts(kept.info.run_id)}
        assert {"landmarks.csv", "metrics.json", "scene.png"} <= files
    assert "nothing to hand in" in call("sync", "folder=.", settings=(), cwd=tmp_path).stdout


def test_runs_are_listed_with_the_command_that_goes_on(begin, endless, tmp_path):
    process = endless()
    process.kill()
    process.communicate()
    listed = call("runs", "tracking.uri=sqlite:///store.db", settings=(), cwd=tmp_path)
    assert listed.returncode == 0, listed.stderr
    (run,) = runs(tmp_path)
    assert run.info.status == "FAILED"  # its process is gone
    assert run.info.run_name in listed.stdout
    (again,) = re.findall(r"^python -m pipelines\.optimise (.*)$", listed.stdout, re.MULTILINE)
    assert again.endswith(f"resume={tmp_path / 'run'}")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run", "store.db", "store.db.lock"]
    saved = (tmp_path / "run" / "checkpoint.npz").stat().st_mtime_ns
    process = begin(command("runs", "tracking.uri=sqlite:///store.db", "resume=last", settings=()), tmp_path)
    while (tmp_path / "run" / "checkpoint.npz").stat().st_mtime_ns == saved and process.poll() is None:
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    code, out, _ = ended(process)
    assert code == 128 + signal.SIGINT
    assert again in out
    (run,) = runs(tmp_path)
    assert run.info.status == "KILLED"
    assert "reason" not in run.data.tags
