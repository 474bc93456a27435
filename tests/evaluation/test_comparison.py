import json
import signal
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from mlflow import MlflowClient
from processes import call, command, start

from lmd.evaluation.comparison import OptimiserRun, best_at, comparison_table
from lmd.objectives.coverage import Coverage
from lmd.optimisers.base import Record
from lmd.scene.deployment import Deployment
from pipelines.reproduction.comparison import to_markdown


def run_of(name, seed, *fitness):
    history = [Record(10 * (i + 1), value, i + 1.0) for i, value in enumerate(fitness)]
    metrics = {"qualified_ratio": fitness[-1], "average_coverage_probability": 0.5, "maximum_coverage_probability": 0.9}
    return OptimiserRun(name, seed, metrics, history, Deployment([[0.0, 1.0, 1.0]], [[1.0, 0.0, 0.0]]))


KEY = "qualified_ratio"
RUNS = [
    run_of("slow", 0, 0.2, 0.4),
    run_of("slow", 1, 0.1, 0.5),
    run_of("fast", 0, 0.5, 0.9),
    run_of("fast", 1, 0.7, 0.8),
]


def test_the_best_median_comes_first():
    table = comparison_table(RUNS, KEY)
    assert table.optimiser.tolist() == ["fast", "slow"]
    assert table.qualified_ratio.tolist() == pytest.approx([0.85, 0.45])
    assert table.qualified_ratio_min.tolist() == [0.8, 0.4]


def test_milestones_count_evaluations_and_infinity_means_never():
    table = comparison_table(RUNS, KEY)
    assert table["evaluations_to_50%"].tolist() == [10.0, np.inf]
    assert table["evaluations_to_65%"].tolist() == [15.0, np.inf]


def test_the_markdown_table_has_a_row_for_each():
    lines = to_markdown(comparison_table(RUNS, KEY), Coverage.headline).splitlines()
    assert len(lines) == 4
    assert "**85.00%** (80.00% to 90.00%)" in lines[2]
    assert "–" in lines[3]


def test_curves_are_steps():
    curve = best_at(RUNS[:1], "evaluations", np.array([5, 10, 15, 20, 99]))
    np.testing.assert_array_equal(curve, [[np.nan, 0.2, 0.2, 0.4, 0.4]])


@pytest.mark.slow
def test_a_comparison_leaves_a_table_a_plot_and_nested_runs(tmp_path):
    done = call(
        "compare", "optimisers=[ega,'ega optimiser.population=12']", "seeds=2", "budget.evaluations=40",
        "deployment.count=20", "hydra.run.dir=run", "save_as=docs/table", "tracking.uri=sqlite:///store.db",
        cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    table = pd.read_csv(tmp_path / "run" / "comparison.csv")
    assert set(table.optimiser) == {"ega", "ega optimiser.population=12"}
    assert (table.runs == 2).all()
    for kind in ("md", "png"):
        saved = (tmp_path / "docs" / f"table.{kind}").read_bytes()
        assert saved == (tmp_path / "run" / f"comparison.{kind}").read_bytes()
    runs = MlflowClient(tracking_uri=f"sqlite:///{tmp_path}/store.db").search_runs(["1"])
    parents = [r.data.tags.get("mlflow.parentRunId") for r in runs]
    (parent,) = [r.info.run_id for r in runs if "mlflow.parentRunId" not in r.data.tags]
    assert sorted(map(str, parents)) == sorted(["None"] + 4 * [parent])
    assert all(r.info.status == "FINISHED" for r in runs)


@pytest.mark.slow
def test_a_comparison_gives_what_single_runs_give(tmp_path):
    shared = ("deployment.count=20", "tag.edge=0.05", "tracking=none", "budget.evaluations=40")
    call("compare", *shared, "optimisers=[ega]", "seeds=1", "seed=3", "workers=1", "hydra.run.dir=many", cwd=tmp_path)
    call("optimise", *shared, "optimiser=ega", "seed=3", "hydra.run.dir=one", cwd=tmp_path)
    one = json.loads((tmp_path / "one" / "metrics.json").read_text())
    landmarks = Path("landmarks.csv")
    kept = tmp_path / "many" / "runs" / "ega seed=3" / landmarks
    assert kept.read_text().startswith("id,x,y,z,nx,ny,nz,ux,uy,uz\n")
    assert kept.read_text() == (tmp_path / "one" / landmarks).read_text()
    assert pd.read_csv(tmp_path / "many" / "comparison.csv").qualified_ratio[0] == one["qualified_ratio"]


@pytest.mark.slow
def test_an_interrupted_comparison_keeps_a_table_of_what_is_finished(tmp_path):
    overrides = ["optimisers=[ega]", "seeds=500", "workers=1", "budget.evaluations=20", "deployment.count=20"]
    overrides += ["hydra.run.dir=run", "tracking.uri=sqlite:///store.db"]
    process = start(command("compare", *overrides), cwd=tmp_path, stdout=subprocess.PIPE)
    assert process.stdout.readline().startswith("1/500 ega seed=0")
    process.send_signal(signal.SIGINT)
    process.communicate()
    assert process.returncode != 0
    (row,) = pd.read_csv(tmp_path / "run" / "comparison.csv").itertuples()
    assert 1 <= row.runs < 500
    runs = MlflowClient(tracking_uri=f"sqlite:///{tmp_path}/store.db").search_runs(["1"])
    assert sorted({run.info.status for run in runs}) == ["FINISHED", "KILLED"]


@pytest.mark.slow
def test_a_misspelt_optimiser_fails_before_anything_runs(tmp_path):
    done = call("compare", "optimisers=[ega,egg]", "tracking=none", "hydra.run.dir=run", cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith("error: optimisers: 'egg' is refused")
    assert not (tmp_path / "run").exists()


PLUGIN = """
from lmd.optimisers.base import AskTell


class HillClimber(AskTell):
    def __init__(self, step=0.1, seed=0):
        super().__init__(seed)
        self.step = step

    def _ask(self):
        if self.best_genes is None:
            return self.start
        return self.best_genes + self.rng.normal(0.0, self.step, (4, self.dim))

    def _tell(self, genes, fitness):
        pass
"""


@pytest.mark.slow
def test_an_optimiser_is_added_from_a_folder_outside_the_repository(tmp_path):
    group = tmp_path / "mine" / "optimiser"
    group.mkdir(parents=True)
    (group / "hill.yaml").write_text("_target_: climbing.HillClimber\nstep: 0.05\n")
    (tmp_path / "climbing.py").write_text(PLUGIN)
    overrides = [f"hydra.searchpath=[file://{tmp_path}/mine]", "optimiser=hill", "budget.evaluations=33",
                 "deployment.count=20", "hydra.run.dir=run",
                 "tracking.uri=sqlite:///store.db"]  # fmt: skip
    done = call("optimise", *overrides, cwd=tmp_path, folders=[tmp_path])
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "run" / "metrics.json").read_text())["evaluations"] == 33
    (run,) = MlflowClient(tracking_uri=f"sqlite:///{tmp_path}/store.db").search_runs(["1"])
    assert run.data.tags["choice.optimiser"] == "hill"
    assert run.data.params["optimiser.step"] == "0.05"
