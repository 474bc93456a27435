"""Several processes at once, and a sweep, against a real mlflow server on a real PostgreSQL, on the loopback."""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest
from mlflow import MlflowClient
from processes import call, ensure_warm
from services import free_port, mlflow_server, service

from pipelines.operations.sweeps.forks import context
from pipelines.operations.tracking import MlflowTracker, RunStart

PROCESSES, POINTS = 4, 1600


def program(name):
    """Path of one of PostgreSQL's programs, if it is installed; Debian keeps them off the PATH."""
    packaged = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    return shutil.which(name) or (str(packaged[-1]) if packaged else None)


def missing():
    """Why the tests cannot run here, if they cannot."""
    if program("initdb") is None or program("postgres") is None:
        return "PostgreSQL is not installed (Debian: apt-get install postgresql)"
    if os.geteuid() == 0 and subprocess.run(["id", "postgres"], capture_output=True, check=False).returncode:
        return "PostgreSQL refuses to run as root, and there is no user postgres"
    return pytest.importorskip("psycopg2", reason="psycopg2 is not installed") and None


REASON = missing()
pytestmark = [
    pytest.mark.slow, pytest.mark.thorough("pipelines/operations"),
    pytest.mark.skipif(REASON is not None, reason=str(REASON)),
]  # fmt: skip


@pytest.fixture(scope="module")
def database():
    """The address of an empty database in a cluster of its own."""
    import psycopg2

    owner = {"user": "postgres", "group": "postgres", "extra_groups": []} if os.geteuid() == 0 else {}
    with tempfile.TemporaryDirectory(prefix="lmd_postgres_") as name:
        home, port = Path(name), free_port()
        if owner:
            shutil.chown(home, "postgres")
        data, log = home / "data", home / "log"
        initdb = [program("initdb"), "-D", data, "-U", "lmd", "--auth=trust", "--no-sync"]
        subprocess.run(initdb, check=True, stdout=subprocess.DEVNULL, cwd=home, **owner)
        options = {"listen_addresses": "127.0.0.1", "unix_socket_directories": home, "fsync": "off"}
        settings = [word for key, value in options.items() for word in ("-c", f"{key}={value}")]
        command = [program("postgres"), "-D", data, "-p", str(port), *settings]
        address = f"host=127.0.0.1 port={port} user=lmd"

        def up():
            return psycopg2.connect(f"{address} dbname=postgres").close() is None

        with service(command, up, log, cwd=home, **owner):
            connection = psycopg2.connect(f"{address} dbname=postgres")
            connection.autocommit = True
            connection.cursor().execute("CREATE DATABASE mlflow")
            connection.close()
            yield f"postgresql+psycopg2://lmd@127.0.0.1:{port}/mlflow"


@pytest.fixture(scope="module")
def server(database, tmp_path_factory):
    """The address of an mlflow server that keeps its runs in `database`, as docs/sweeps.md starts it."""
    with mlflow_server(database, tmp_path_factory.mktemp("server")) as address:
        yield address


def record_one(server, number, folder, together):
    file = folder / f"{number}.csv"
    file.write_text("id\n")
    together.wait()
    tracker = MlflowTracker(server, "together")
    tracker.start(RunStart(f"run {number}", folder / str(number), {"seed": number}, {"number": str(number)}))
    tracker.log_curve("best_fitness", [(i, i / POINTS, 0.01 * i) for i in range(POINTS)])
    tracker.log_metrics({"fitness": number / PROCESSES})
    tracker.log_artifacts([file])
    tracker.finish("FINISHED")


def test_processes_that_record_at_once_lose_nothing(server, tmp_path):
    ensure_warm()
    together = context.Barrier(PROCESSES)
    processes = [context.Process(target=record_one, args=(server, i, tmp_path, together)) for i in range(PROCESSES)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0] * PROCESSES
    client = MlflowClient(tracking_uri=server)
    runs = client.search_runs([client.get_experiment_by_name("together").experiment_id])
    assert sorted(run.data.tags["number"] for run in runs) == [str(i) for i in range(PROCESSES)]
    for run in runs:
        number = int(run.data.params["seed"])
        assert run.info.status == "FINISHED"
        assert run.data.metrics["fitness"] == number / PROCESSES
        curve = client.get_metric_history(run.info.run_id, "best_fitness")
        assert sorted((point.step, point.value) for point in curve) == [(i, i / POINTS) for i in range(POINTS)]
        assert [file.path for file in client.list_artifacts(run.info.run_id)] == [f"{number}.csv"]


def test_a_sweep_is_recorded_on_the_server(server, tmp_path):
    """Several at once are in the test above."""
    overrides = ("objective.n=2,3", "hydra.mode=MULTIRUN", "localisation=false", "losses=false")
    done = call("evaluate", *overrides, f"tracking.uri={server}", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    client = MlflowClient(tracking_uri=server)
    runs = client.search_runs([client.get_experiment_by_name("lmd").experiment_id])
    assert [run.info.status for run in runs] == ["FINISHED"] * 3
    (parent,) = [run for run in runs if "mlflow.parentRunId" not in run.data.tags]
    assert [file.path for file in client.list_artifacts(parent.info.run_id)] == ["jobs.csv"]
    children = [run for run in runs if run is not parent]
    assert {run.data.tags["mlflow.parentRunId"] for run in children} == {parent.info.run_id}
    for run in children:
        names = {file.path for file in client.list_artifacts(run.info.run_id)}
        assert {"landmarks.csv", "metrics.json", "history.csv"} <= names
