"""`pipelines.evaluate` with tags that hang elsewhere than planned, as a user meets it."""

import json
import sys

import pandas as pd
import processes
import pytest
from composing import composed
from mlflow import MlflowClient

from pipelines.evaluate import read_mounting_error
from pipelines.nodes import instantiate

# In the plan the papers of 3 and 5 share an edge; as measured they overlap.
PLAN = "id,x,y,z,nx,ny,nz\n3,0,2,3,1,0,0\n5,0,2.25,3,1,0,0\n8,7.5,2,3,-1,0,0\n"
MEASURED = "id,x,y,z,nx,ny,nz\n8,7.5,2,3,-1,0,0\n5,0,2.25,3,1,0,0\n3,0,2.03,3.04,1,0,0\n"
SMALL = ["room.spacing=1.5", "hydra.run.dir=run", "tag.edge=0.2", "deployment=file", "deployment.path=plan.csv"]
QUICK = ("validate=false", "picture=false", "localisation=false", "losses=false")


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "plan.csv").write_text(PLAN)
    return tmp_path


def written(folder):
    return json.loads((folder / "run" / "metrics.json").read_text())


def logged(folder):
    client = MlflowClient(tracking_uri=f"sqlite:///{folder}/outputs/mlflow.db")
    (run,) = client.search_runs([client.get_experiment_by_name("lmd").experiment_id])
    return run.data.metrics, {file.path for file in client.list_artifacts(run.info.run_id)}


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        ("0.005", {"position": 0.005, "tilt": 0.0}),
        ("{position: 0.01, tilt: 0.02}", {"position": 0.01, "tilt": 0.02}),
        ("{tilt: 0.02}", {"position": 0.0, "tilt": 0.02}),
    ],
)
def test_a_mounting_error_may_be_a_mapping(monkeypatch, error, expected):
    monkeypatch.setattr(sys, "argv", ["evaluate", f"deployment.mounting_error={error}"])
    read_mounting_error()
    found = instantiate(composed("evaluate", *sys.argv[1:]).deployment.mounting_error)
    assert {name: getattr(found, name) for name in expected} == expected


@pytest.mark.slow
def test_a_mounting_error_is_a_number_or_more(folder):
    done = processes.inside("evaluate", "deployment.mounting_error=0.005", "deployment.mounting_error.tilt=0.01",
                          "deployment.mounting_error.draws=5", *QUICK, cwd=folder, settings=SMALL)  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "tags off by 5 mm along their surface, turned by 0 and tilted by 10 mrad (1 sigma); 5 draws" in done.stdout
    table = pd.read_csv(folder / "run" / "mounting.csv", index_col="figure")
    assert len(pd.read_csv(folder / "run" / "mountings.csv")) == 5
    figures, (metrics, artifacts) = written(folder)["mounting"], logged(folder)
    assert figures["fitness/50"] == pytest.approx(table.loc["fitness", "50 %"])
    assert {key: metrics[f"mounting/{key}"] for key in figures} == figures
    assert {"mounting.csv", "mountings.csv", "mounting_views.csv"} <= artifacts
    assert not list((folder / "run").glob("*.png"))  # QUICK has picture=false


@pytest.mark.slow
def test_measured_places_are_scored_in_place_of_the_plan(folder):
    survey = folder / "run" / "measured.csv"  # beside what comes out
    survey.parent.mkdir()
    survey.write_text(MEASURED)
    asked = (f"deployment.measured={survey}", *QUICK, "picture=true")
    done = processes.inside("evaluate", *asked, cwd=folder, settings=SMALL)
    assert done.returncode == 0, done.stderr
    assert "at most 50.0 mm" in done.stdout
    assert survey.read_text() == MEASURED
    moved = pd.read_csv(folder / "run" / "moved.csv").iloc[0]
    assert (moved["id"], moved.moved) == (3, pytest.approx(0.05))
    assert pd.read_csv(folder / "run" / "landmarks.csv").iloc[0].y == 2.03  # what hangs is what the run is about
    document = written(folder)
    assert document["survey"]["fitness/measured"] == document["fitness"]
    assert {"moved.csv", "survey.csv", "survey.png"} <= logged(folder)[1]
    for pipeline, *settings in (("export", "formats=[csv]"), ("observe", "seeds=1", "trajectory.duration=2")):
        done = processes.inside(pipeline, "run=run", f"hydra.run.dir={pipeline}", cwd=folder,
                              settings=["tracking=none", *settings])  # fmt: skip
        assert done.returncode == 0, done.stderr
    assert pd.read_csv(folder / "export" / "tags.csv").set_index("id").y.to_dict() == {3: 2.03, 5: 2.25, 8: 2.0}
