"""The two commands as a user meets them: a process, its messages, its exit code and the files it leaves."""

import json
import re

import pandas as pd
import pytest
from mlflow import MlflowClient
from processes import call, inside

FILES = ["convergence.png", "history.csv", "landmarks.csv", "metrics.json", "room.png", "scene.png"]
pytestmark = [pytest.mark.slow, pytest.mark.long]
QUICK = ("localisation=false", "losses=false")  # of an evaluation
HEADER = "id,x,y,z,nx,ny,nz\n"


def read_metrics(directory):
    return json.loads((directory / "metrics.json").read_text())


@pytest.fixture(scope="module")
def optimised(tmp_path_factory):
    """A tracked run of 90 evaluations in its own working directory."""
    cwd = tmp_path_factory.mktemp("work")
    overrides = ("optimiser=ega", "budget.evaluations=90", "deployment.count=40", "picture=true")
    done = call("optimise", *overrides, "hydra.run.dir=run", cwd=cwd)
    assert done.returncode == 0, done.stderr
    return cwd, done.stdout


def test_a_run_leaves_its_files_and_nothing_else(optimised):
    cwd, _ = optimised
    left = {path.name for path in (cwd / "run").iterdir()}
    assert left == {*FILES, ".hydra", "checkpoint.npz"}
    assert all((cwd / "run" / name).stat().st_size for name in FILES)


def test_the_files_follow_the_contract(optimised):
    run = optimised[0] / "run"
    assert (run / "landmarks.csv").read_text().startswith(HEADER)
    assert len(pd.read_csv(run / "landmarks.csv")) == 40
    history = pd.read_csv(run / "history.csv")
    assert list(history) == ["evaluations", "best_fitness", "wall_time"]
    assert history.evaluations.iloc[-1] == 90
    metrics = read_metrics(run)
    for key in ("qualified_ratio", "average_coverage_probability", "maximum_coverage_probability"):
        assert 0.0 <= metrics[key] <= 1.0
    assert metrics["evaluations"] == 90
    assert metrics["settings"]["n"] == 2


def test_the_terminal_shows_the_figures_and_where_things_are(optimised):
    cwd, out = optimised
    assert re.search(r"qualified ratio +\d+\.\d\d% of 36 positions see at least 2 of 40 landmarks", out)
    assert str(cwd / "run" / "scene.png") in out
    assert re.search(r"mlflow +run [0-9a-f]{32} in sqlite:///outputs/mlflow\.db", out)


def test_mlflow_has_the_run(optimised):
    cwd, _ = optimised
    client = MlflowClient(tracking_uri=f"sqlite:///{cwd}/outputs/mlflow.db")
    (run,) = client.search_runs([client.get_experiment_by_name("lmd").experiment_id])
    assert run.info.status == "FINISHED"
    assert run.data.params["deployment.count"] == "40"
    assert run.data.tags["choice.optimiser"] == "ega"
    assert "budget.evaluations=90" in run.data.tags["overrides"]
    assert run.data.metrics["qualified_ratio"] == read_metrics(cwd / "run")["qualified_ratio"]
    curve = client.get_metric_history(run.info.run_id, "best_fitness")
    assert [point.step for point in curve] == list(range(1, 91))  # each hundredth of the budget, rounded up
    history = pd.read_csv(cwd / "run" / "history.csv")
    assert all(point.value == history[history.evaluations <= point.step].best_fitness.max() for point in curve)
    (problem,) = (given.dataset for given in run.inputs.dataset_inputs)
    assert (problem.name, json.loads(problem.profile)["K"]) == ("paper_simulation n=2 p=0.5 K=40", "40")
    kept = {file.path for file in client.list_artifacts(run.info.run_id)}
    assert {*FILES, "config.yaml", "packages.txt"} <= kept
    told = run.data.tags["mlflow.note.content"]
    assert f"`{run.data.tags['command']}`\n\nat commit {run.data.tags['mlflow.source.git.commit'][:9]}" in told
    is_changed = run.data.tags["uncommitted changes"] == "yes"
    assert ("diff.patch" in kept, "with the changes in diff.patch" in told) == (is_changed, is_changed)


def test_evaluating_what_was_optimised_gives_the_same_metrics(optimised):
    cwd, _ = optimised
    overrides = ("deployment=file", "deployment.path=run/landmarks.csv", "hydra.run.dir=score", "tracking=none")
    done = inside("evaluate", *overrides, *QUICK, cwd=cwd)
    assert done.returncode == 0, done.stderr
    before, after = read_metrics(cwd / "run"), read_metrics(cwd / "score")
    for key in ("qualified_ratio", "average_coverage_probability", "settings"):
        assert after[key] == before[key]
    assert (cwd / "score" / "landmarks.csv").read_bytes() == (cwd / "run" / "landmarks.csv").read_bytes()
    assert {path.name for path in (cwd / "score").iterdir()} & {"checkpoint.npz", "convergence.png"} == set()


def test_same_config_same_result(optimised):
    cwd, _ = optimised
    inside("optimise", "optimiser=ega", "budget.evaluations=90", "deployment.count=40", "hydra.run.dir=again",
         "tracking=none", "threads=1", cwd=cwd)  # fmt: skip
    assert (cwd / "again" / "landmarks.csv").read_bytes() == (cwd / "run" / "landmarks.csv").read_bytes()


def test_a_run_is_validated_off_its_grid(tmp_path):
    robust = ("objective=robust", "objective.sampling.positions=4")
    overrides = ("validate=true", *robust, "tracking.uri=sqlite:///store.db")
    done = inside("evaluate", *overrides, *QUICK, "hydra.run.dir=run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    metrics = read_metrics(tmp_path / "run")
    validation = metrics["validation"]
    errors = [f"grid_free_{key}" for key in ("qualified_ratio", "average_coverage_probability")]
    assert set(validation) == {"finer_grid_qualified_ratio", *errors, *(f"{key}_standard_error" for key in errors)}
    assert all(0.0 < value < 1.0 for value in validation.values())
    assert metrics["fitness"] != metrics["qualified_ratio"]
    assert metrics["settings"]["sampling"] == {"positions": 4, "divisions": 18}
    (run,) = MlflowClient(tracking_uri=f"sqlite:///{tmp_path}/store.db").search_runs(["1"])
    recorded = {key: value for key, value in validation.items() if not key.endswith("standard_error")}
    assert {f"validation/{key}": value for key, value in recorded.items()} == {
        key: value for key, value in run.data.metrics.items() if key.startswith("validation/")
    }
    assert re.search(r"on a finer grid +qualified ratio \d+\.\d\d%", done.stdout)
    assert re.search(r"off the grid +\d+\.\d\d% \+- \d\.\d\d% of random positions qualified", done.stdout)


def test_where_nothing_is_covered_the_terminal_says_why(optimised, tmp_path):
    cwd, out = optimised
    assert "criterion" not in out
    assert 0.0 < read_metrics(cwd / "run")["criteria"]["covered"] < 1.0
    overrides = ("visibility.thold=1.2", *QUICK, "tracking.uri=sqlite:///store.db")
    done = inside("evaluate", *overrides, "hydra.run.dir=run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert re.search(r"\ncriterion .*\nresolution .* depth up to 0\.72 m \(thold = 1\.2 pixel/mm\)\n", done.stdout)
    criteria = read_metrics(tmp_path / "run")["criteria"]
    assert criteria["covered"] == 0.0
    assert criteria["covered_without_resolution"] > 0.0


def test_validation_can_be_left_out(optimised):
    cwd, out = optimised
    assert "validation" not in read_metrics(cwd / "run")
    assert "off the grid" not in out


def test_ids_and_notes_go_through_the_pipelines(tmp_path):
    table = "# of the lab\nid,x,y,z,nx,ny,nz,note\n7,0,1,1,1,0,0,door\n3,0,2,1,1,0,0,\n9,7.5,2,1,-1,0,0,shelf\n"
    (tmp_path / "lab.csv").write_text(table)
    quick = ("objective.thold_p=0.05", "tracking=none")
    for pipeline, *overrides in (
        ("evaluate", "deployment=file", "deployment.path=lab.csv", "objective.n=1", *QUICK, "hydra.run.dir=scored"),
        ("optimise", "run=scored", "budget.evaluations=1e2", "seed=1e0", "hydra.run.dir=moved"),
    ):
        done = inside(pipeline, *overrides, *quick, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    scored, moved = (
        pd.read_csv(tmp_path / name / "landmarks.csv", keep_default_na=False) for name in ("scored", "moved")
    )
    for found in (scored, moved):
        assert found.id.tolist() == [7, 3, 9]
        assert found.note.tolist() == ["door", "", "shelf"]
    assert not scored.drop(columns=["id", "note"]).equals(moved.drop(columns=["id", "note"]))


def test_an_experiment_that_another_command_cannot_compose_names_its_own(tmp_path):
    done = inside("export", "experiment=frc_2025", cwd=tmp_path, settings=())
    assert done.returncode == 1
    assert "experiment=frc_2025 is for another command: python -m pipelines.evaluate experiment=frc_2025" in done.stderr


def test_the_lab_is_optimised_by_one_word(tmp_path):
    settings = ("room.spacing=1", "deployment.count=12", "tracking=none", "picture=false", "hydra.run.dir=run")
    done = inside("optimise", "experiment=lab", "budget.evaluations=60", cwd=tmp_path, settings=settings)
    assert done.returncode == 0, done.stderr
    metrics, table = read_metrics(tmp_path / "run"), pd.read_csv(tmp_path / "run" / "landmarks.csv")
    assert len(table) == 12
    assert (table.z > 0.075).all()  # nothing on the floor, no tag over an edge
    assert 0.0 < metrics["localised_share"] < 1.0
    assert 0.0 < metrics["validation"]["grid_free_localised_share"] < 1.0
    assert "probability of localising to 20 mm, with 12 landmarks" in done.stdout
