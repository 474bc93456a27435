"""What mlflow and the terminal have of a run, and validation off the grid."""

import json
import re

import pandas as pd
import pytest
from mlflow import MlflowClient
from support.processes import inside

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
    assert (problem.name, json.loads(problem.profile)["K"]) == ("paper_simulation n=2 p=0.5 K=40", "40")
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


@pytest.mark.thorough("pipelines", "conf", "lmd/objectives/localisation", "lmd/optimisers/annealing")
def test_the_lab_is_optimised_by_one_word(tmp_path):
    settings = ("room.spacing=1", "deployment.count=12", "tracking=none", "picture=false", "hydra.run.dir=run")
    done = inside("optimise", "experiment=lab", "budget.evaluations=60", cwd=tmp_path, settings=settings)
    assert done.returncode == 0, done.stderr
    metrics, table = (tmp_path / "run" / name for name in ("metrics.json", "landmarks.csv"))
    assert (pd.read_csv(table).z > 0.075).all()  # nothing on the floor, no tag over an edge
    found = json.loads(metrics.read_text())
    assert 0.0 < found["localised_share"] < 1.0
    assert 0.0 < found["validation"]["grid_free_localised_share"] < 1.0


@pytest.mark.thorough("pipelines/optimise.py", "pipelines/composing.py", "lmd/cameras", "lmd/optimisers/alternating.py")
def test_cameras_and_tags_are_placed_in_turns_from_an_earlier_run(tmp_path):
    body = "body.boxes=[{low: [-0.1, -0.1, 0], high: [0.1, 0.1, 0.2]}]"
    tags = ("deployment=uniform", "deployment.count=12", "pdf=yaw", "pdf.divisions=3", "objective.thold_p=0.3")
    quiet = ("tracking=none", "validate=false", "picture=false")
    words = ("varies=cameras", *tags, body, "body.margin=0.05", "room.spacing=1.5", "budget.evaluations=12")
    done = inside("optimise", *words, "hydra.run.dir=run", cwd=tmp_path, settings=quiet)
    assert done.returncode == 0, done.stderr
    more = ("varies=cameras", "run=run", "rounds=2", "tag_evaluations=12", "budget.evaluations=6")
    done = inside("optimise", *more, "hydra.run.dir=rounds", cwd=tmp_path, settings=quiet)
    assert done.returncode == 0, done.stderr
    assert "margin: 0.05" in (tmp_path / "rounds" / ".hydra" / "config.yaml").read_text()  # the body is that of the run
    found, turns = (json.loads((tmp_path / name / "metrics.json").read_text()) for name in ("run", "rounds"))
    told = list(turns["rounds"].values())
    assert len(told) == 4
    assert [found["fitness"], *told] == sorted([found["fitness"], *told])
    assert turns["fitness"] == told[-1]
    again = ("run=run", "localisation=false", "losses=false", "hydra.run.dir=again")
    assert inside("evaluate", *again, cwd=tmp_path, settings=quiet).returncode == 0
    assert json.loads((tmp_path / "again" / "metrics.json").read_text())["fitness"] == found["fitness"]


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
