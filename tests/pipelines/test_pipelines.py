"""What mlflow and the terminal have of a run, and validation off the grid."""

import json
import re

import pandas as pd
import pytest
from mlflow import MlflowClient
from support.processes import inside, refused

pytestmark = [pytest.mark.slow, pytest.mark.long]


def test_mlflow_has_the_run(tmp_path):
    words = ("optimiser=ega", "budget.evaluations=90", "deployment.count=40", "hydra.run.dir=run")
    done = inside("optimise", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert re.search(r"mlflow +run [0-9a-f]{32} in sqlite:///outputs/mlflow\.db", done.stdout)
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert (metrics["evaluations"], metrics["settings"]["n"], "validation" in metrics) == (90, 2, False)
    client = MlflowClient(tracking_uri=f"sqlite:///{tmp_path}/outputs/mlflow.db")
    (run,) = client.search_runs([client.get_experiment_by_name("lmd").experiment_id])
    assert run.data.params["deployment.count"] == "40"
    assert run.data.tags["choice.optimiser"] == "ega"
    assert "budget.evaluations=90" in run.data.tags["overrides"]
    curve = client.get_metric_history(run.info.run_id, "best_fitness")
    assert [point.step for point in curve] == list(range(1, 91))  # each hundredth of the budget, rounded up
    history = pd.read_csv(tmp_path / "run" / "history.csv")
    assert all(point.value == history[history.evaluations <= point.step].best_fitness.max() for point in curve)
    (problem,) = (given.dataset for given in run.inputs.dataset_inputs)
    assert (problem.name, len(problem.digest)) == ("paper_simulation n=2 p=0.5 K=40", 16)
    words = ("optimiser=ega", "budget.evaluations=120", "deployment.count=40", "resume=run")
    assert inside("optimise", *words, "hydra.run.dir=more", cwd=tmp_path).returncode == 0
    more, _ = client.search_runs([client.get_experiment_by_name("lmd").experiment_id])
    assert more.data.tags["continues"] == run.info.run_id  # whose budget is another one
    curve = client.get_metric_history(more.info.run_id, "best_fitness")
    assert (curve[0].step, curve[-1].step, more.data.metrics["evaluations"]) == (1, 120, 120)  # it is whole
    other = ("objective.n=3", "hydra.run.dir=other")
    refused("optimise", *words, *other, message="was made with objective.n = 2, not 3", cwd=tmp_path)
    told = run.data.tags["mlflow.note.content"]
    assert f"`{run.data.tags['command']}`\n\nat commit {run.data.tags['mlflow.source.git.commit'][:9]}" in told


def test_a_run_is_validated_off_its_grid(tmp_path):
    robust = ("objective=robust", "objective.sampling.positions=4", "localisation=false", "losses=false")
    words = ("validate=true", *robust, "tracking.uri=sqlite:///store.db", "hydra.run.dir=run")
    done = inside("evaluate", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    validation = metrics["validation"]
    errors = [f"grid_free_{key}" for key in ("qualified_ratio", "average_coverage_probability")]
    assert set(validation) == {"finer_grid_qualified_ratio", *errors, *(f"{key}_standard_error" for key in errors)}
    assert all(0.0 < value < 1.0 for value in validation.values())
    assert metrics["fitness"] != metrics["qualified_ratio"]
    (run,) = MlflowClient(tracking_uri=f"sqlite:///{tmp_path}/store.db").search_runs(["1"])
    recorded = {f"validation/{key}": v for key, v in validation.items() if not key.endswith("standard_error")}
    assert recorded == {key: value for key, value in run.data.metrics.items() if key.startswith("validation/")}
    assert re.search(r"on a finer grid +qualified ratio \d+\.\d\d%", done.stdout)


def test_measured_places_are_scored_in_place_of_the_plan(tmp_path):
    """In the plan the papers of 3 and 5 share an edge; as measured they overlap."""
    plan = "id,x,y,z,nx,ny,nz\n3,0,2,3,1,0,0\n5,0,2.25,3,1,0,0\n8,7.5,2,3,-1,0,0\n"
    measured = "id,x,y,z,nx,ny,nz\n8,7.5,2,3,-1,0,0\n5,0,2.25,3,1,0,0\n3,0,2.03,3.04,1,0,0\n"
    (tmp_path / "plan.csv").write_text(plan)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "measured.csv").write_text(measured)  # beside what comes out
    words = ("deployment.path=plan.csv", "deployment.measured=run/measured.csv", "tag.edge=0.2", "room.spacing=1.5")
    quick = ("validate=false", "picture=false", "localisation=false", "losses=false", "tracking=none")
    done = inside("evaluate", *words, *quick, "hydra.run.dir=run", cwd=tmp_path, settings=())
    assert done.returncode == 0, done.stderr
    assert "at most 50.0 mm" in done.stdout
    assert (tmp_path / "run" / "measured.csv").read_text() == measured
    assert pd.read_csv(tmp_path / "run" / "landmarks.csv").iloc[0].y == 2.03  # what hangs is what the run is about
    document = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert document["survey"]["fitness/measured"] == document["fitness"]
    done = inside("export", "run=run", "formats=[csv]", "tracking=none", "hydra.run.dir=out", cwd=tmp_path, settings=())
    assert done.returncode == 0, done.stderr
    assert pd.read_csv(tmp_path / "out" / "tags.csv").set_index("id").y.to_dict() == {3: 2.03, 5: 2.25, 8: 2.0}
