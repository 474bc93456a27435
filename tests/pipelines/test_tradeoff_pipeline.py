"""`pipelines.tradeoff` as a user meets it."""

import json
import os
import re
import signal
import subprocess
import time

import numpy as np
import pandas as pd
import pytest
from mlflow import MlflowClient
from support import processes

from lmd.scene.deployment import Deployment

pytestmark = pytest.mark.slow
SMALL = ("room.spacing=1.5", "objective.n=1", "objective.thold_p=0.3", "budget.evaluations=20", "seeds=2")
COUNTS = "counts=[6,10]"
FIGURE = "localised_share_20mm"
SOME = (COUNTS, "edges=[0.1]", "seeds=1", "tracking=none")


def tradeoff(cwd, *overrides, directory="run"):
    return processes.inside("tradeoff", *overrides, f"hydra.run.dir={directory}", cwd=cwd, settings=SMALL)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    cwd = tmp_path_factory.mktemp("tradeoff")
    run = tradeoff(cwd, COUNTS, "edges=[0.1,1]", "wanted=0.2", f"figure={FIGURE}", "workers=1")
    assert run.returncode == 0, run.stderr
    return cwd, run


def test_a_row_for_each_point_and_the_fewest_between_the_counts(done):
    cwd, run = done
    points = pd.read_csv(cwd / "run" / "points.csv")
    for edge, same in points.groupby("edge"):
        assert {6, 10} <= set(same["count"])
        assert (same.groupby("count").size() == 2).all()
        document = json.loads((cwd / "run" / "tradeoff.json").read_text())
        (fewest,) = (row["count"] for row in document["fewest"] if row["edge"] == edge)
        medians = same.groupby("count")[FIGURE].median()
        if fewest is None:  # no count of the small tags reaches 0.2
            assert (edge, (medians < 0.2).all()) == (0.1, True)
            continue
        assert 6 < fewest < 10
        assert medians[fewest] >= 0.2
        below = medians[medians.index < fewest]
        assert (below.index[-1], (below < 0.2).all()) == (fewest - 1, True)
    assert "fewest landmarks to reach 20% (views localised to 20 mm)" in run.stdout
    assert (cwd / "run" / "tradeoff.png").is_file()
    front = pd.read_csv(cwd / "run" / "front.csv")
    assert {FIGURE, "qualified_ratio", "grid_free_qualified_ratio"} <= set(front)


def test_more_landmarks_are_never_worse_where_neighbours_help(done):
    points = pd.read_csv(done[0] / "run" / "points.csv").sort_values("count")
    for _, ladder in points.groupby(["edge", "seed"]):
        assert (np.diff(ladder.average_coverage_probability[ladder["count"].isin([6, 10])]) > 0.0).all()


def test_the_run_has_a_child_for_each_point(done):
    cwd, _ = done
    points = pd.read_csv(cwd / "run" / "points.csv")
    client = MlflowClient(tracking_uri=f"sqlite:///{cwd}/outputs/mlflow.db")
    runs = client.search_runs([client.get_experiment_by_name("lmd tradeoff").experiment_id])
    (parent,) = (run for run in runs if "mlflow.parentRunId" not in run.data.tags)
    children = [run for run in runs if run.data.tags.get("mlflow.parentRunId") == parent.info.run_id]
    assert len(children) == len(points) == len(runs) - 1
    assert {run.info.status for run in runs} == {"FINISHED"}
    child = children[0].data
    row = points.set_index(["edge", "count", "seed"]).loc[
        (float(child.params["tag.edge"]), int(child.params["deployment.count"]), int(child.params["seed"]))
    ]
    assert child.metrics[FIGURE] == pytest.approx(row[FIGURE])
    assert child.tags["way"] == row.way
    assert parent.data.metrics["fewest/edge_1"] > 6
    (landmarks,) = (cwd / "run" / "points").glob("K-10-edge-0.1-seed-1/landmarks.csv")
    assert len(Deployment.from_csv(landmarks)) == 10


@pytest.fixture(scope="module")
def rows(done):
    """Of the points of the first edge and seed."""
    header, *rows = (done[0] / "run" / "points.csv").read_text().splitlines()
    some = [row for row in rows if re.match("0.1,(6|10),0,", row)]
    assert len(some) == 2
    return [header, *some]


def test_the_same_again_searches_nothing_and_other_settings_search_anew(done, rows):
    cwd, _ = done
    kept = cwd / "outputs" / "tradeoff" / "kept"
    files = {path.name for path in kept.iterdir()}
    again = tradeoff(cwd, *SOME, "workers=1", directory="again")
    assert again.returncode == 0, again.stderr
    assert (cwd / "again" / "points.csv").read_text().splitlines() == rows
    assert {path.name for path in kept.iterdir()} == files
    other = tradeoff(cwd, *SOME, "counts=[6]", "budget.evaluations=21", "workers=1", directory="other")
    assert other.returncode == 0, other.stderr
    assert len({path.name for path in kept.iterdir()} - files) == 2  # a search and its figures


def test_what_was_finished_when_it_was_interrupted_is_kept(tmp_path):
    points = ("counts=[6,8,10]", "seeds=1")
    line = processes.command("tradeoff", *points, "workers=2", "hydra.run.dir=run", settings=SMALL)
    running = processes.start(
        line, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
    )
    for told in running.stdout:
        if told.startswith("2/3 searched anew"):
            break
    os.killpg(running.pid, signal.SIGINT)  # as a terminal does
    _, told = running.communicate()
    assert running.returncode == 130, told
    assert "interrupted; the same command continues from the results in outputs/tradeoff/kept" in told
    assert "Traceback" not in told
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "outputs/tradeoff/kept").glob("*.json")}
    assert len(kept) >= 2
    client = MlflowClient(tracking_uri=f"sqlite:///{tmp_path}/outputs/mlflow.db")
    (run,) = client.search_runs([client.get_experiment_by_name("lmd tradeoff").experiment_id])
    assert run.info.status == "KILLED"
    time.sleep(0.01)
    again = tradeoff(tmp_path, *points, "workers=1", "tracking=none", directory="again")
    assert again.returncode == 0, again.stderr
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
