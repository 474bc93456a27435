import signal
import subprocess

import numpy as np
import pandas as pd
import pytest
from mlflow import MlflowClient
from support.processes import call, command, start
from support.tables import rows

from lmd.evaluation.comparison import OptimiserRun, attained, best_at, compared, comparison_markdown, curve_targets
from lmd.objectives.coverage import Coverage
from lmd.optimisers.ledger import Record
from lmd.scene.deployment import Deployment


def run_of(name, seed, *fitness):
    history = [Record(10 * (i + 1), value, i + 1.0) for i, value in enumerate(fitness)]
    metrics = {"qualified_ratio": fitness[-1], "average_coverage_probability": 0.5, "maximum_coverage_probability": 0.9}
    return OptimiserRun(name, seed, metrics, history, Deployment([[0.0, 1.0, 1.0]], [[1.0, 0.0, 0.0]]))


KEY = "qualified_ratio"
FITNESS = {"slow": ((0.2, 0.4), (0.1, 0.5)), "fast": ((0.5, 0.9), (0.7, 0.8))}
RUNS = [run_of(name, seed, *fitness) for name, both in FITNESS.items() for seed, fitness in enumerate(both)]


def test_the_best_median_comes_first():
    table = compared(RUNS, KEY).table
    assert table.optimiser.tolist() == ["fast", "slow"]
    assert table.qualified_ratio.tolist() == pytest.approx([0.85, 0.45])
    assert table.qualified_ratio_min.tolist() == [0.8, 0.4]
    assert table["rank"].tolist() == [1.0, 2.0]


def test_targets_come_from_the_runs_and_the_running_time_counts_all_of_them():
    found = compared(RUNS, KEY)
    assert found.targets == (0.5, 0.8, 0.9)
    assert found.table.evaluations_to_1.tolist() == [(10 + 10) / 2, (20 + 20) / 1]
    assert found.table.evaluations_to_2.tolist() == [(20 + 20) / 2, np.inf]


def runs_of(name, *figures):
    return [run_of(name, seed, 0.0, figure) for seed, figure in enumerate(figures)]


GOOD = runs_of("good", *np.linspace(0.8, 0.9, 8))
POOR = runs_of("poor", *np.linspace(0.7, 0.79, 8))
EQUAL = runs_of("equal", *np.linspace(0.8, 0.9, 8))


def test_against_a_reference_runs_of_one_seed_are_pairs():
    found = compared([*GOOD, *POOR, *EQUAL], KEY, "poor")
    rows = found.table.set_index("optimiser")
    assert rows.p_value[["good", "equal"]].tolist() == [4 / 2**8] * 2  # all signs alike, twice for Holm
    assert np.isnan(rows.p_value["poor"])
    assert rows.a12[["good", "poor"]].tolist() == [1.0, 0.5]
    assert (found.reference, found.pairs) == ("poor", None)
    assert "Wilcoxon signed-rank test against `poor`" in found.test
    assert "Holm's correction for 2 comparisons" in found.test


def test_without_one_all_are_tested_against_all():
    found = compared([*GOOD, *POOR, *EQUAL], KEY)
    assert found.pairs.loc["good", "equal"] == pytest.approx(1.0)
    assert found.pairs.loc["good", "poor"] == found.pairs.loc["poor", "good"] < 0.05
    assert found.table["rank"].tolist() == [1.5, 1.5, 3.0]
    assert "Nemenyi's test against `good` on the mean ranks over the 8 seeds" in found.test


def test_of_seeds_that_not_all_have_run_those_of_both_are_pairs():
    found = compared([*GOOD, *POOR[:5], *EQUAL[:1]], KEY, "good")
    rows = found.table.set_index("optimiser")
    assert rows.p_value["poor"] == 2 / 2**5
    assert np.isnan(rows.p_value["equal"])
    assert compared(GOOD[:1], KEY).test == ""


@pytest.mark.parametrize(("seeds", "others", "limit"), rows(__file__, "what seeds can show"))
def test_it_says_what_its_seeds_can_show(seeds, others, limit):
    """The least p of the signed-rank test is 2 / 2^seeds, times the comparisons for Holm."""
    runs = [run for i in range(others + 1) for run in runs_of(f"r{i}", *(0.01 * np.arange(1, seeds + 1) + 0.2 * i))]
    found = compared(runs, KEY, "r0")
    assert found.test.splitlines()[1:] == ["", limit]
    if seeds > 1:
        assert found.table.p_value.min() == pytest.approx(others * 2.0 ** (1 - seeds))


def test_the_markdown_table_has_a_row_for_each_and_says_what_was_tested():
    lines = comparison_markdown(compared(RUNS, KEY), Coverage.headline).splitlines()
    assert "**85.00%** (80.00% to 90.00%)" in lines[2]
    assert "| – |" in lines[3]
    assert lines[4:6] == ["", "p: two-sided Wilcoxon signed-rank test against `fast` on pairs of the same seed."]


def test_the_share_of_targets_grows_to_what_was_reached():
    targets = curve_targets(RUNS)
    assert (targets[0], targets[-1]) == (pytest.approx(0.1 + 0.8 / 50), 0.9)
    share = attained(RUNS, "evaluations", np.array([5.0, 10.0, 20.0]), targets)
    counted = [
        np.mean([best >= t for best in bests for t in targets])
        for bests in ((0.2, 0.1, 0.5, 0.7), (0.4, 0.5, 0.9, 0.8))
    ]
    assert share.tolist() == pytest.approx([0.0, *counted])


def test_curves_are_steps():
    curve = best_at(RUNS[:1], "evaluations", np.array([5, 10, 15, 20, 99]))
    np.testing.assert_array_equal(curve, [[np.nan, 0.2, 0.2, 0.4, 0.4]])


@pytest.mark.slow
def test_an_interrupted_comparison_keeps_a_table_of_what_is_finished_and_goes_on_from_there(tmp_path):
    shared = ["optimisers=[ega]", "workers=1", "budget.evaluations=20", "deployment.count=20", "hydra.run.dir=run"]
    shared += ["tracking.uri=sqlite:///store.db"]
    process = start(
        command("compare", *shared, "seeds=500"), cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout.readline().startswith("1/500 ega seed=0: fitness ")
    process.send_signal(signal.SIGINT)
    _, err = process.communicate()
    assert process.returncode != 0
    assert "interrupted; the same command continues from the results in outputs/compare/kept" in err
    (row,) = pd.read_csv(tmp_path / "run" / "comparison.csv").itertuples()
    assert 1 <= row.runs < 500
    assert sorted({run.info.status for run in recorded(tmp_path)}) == ["FINISHED", "KILLED"]

    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "outputs/compare/kept").glob("*.json")}
    again = call("compare", *shared, f"seeds={row.runs + 1}", "hydra.run.dir=again", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    (grown,) = pd.read_csv(tmp_path / "again" / "comparison.csv").itertuples()
    assert grown.runs == row.runs + 1
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    newest = max(
        (run for run in recorded(tmp_path) if PARENT not in run.data.tags), key=lambda run: run.info.start_time
    )
    children = [run for run in recorded(tmp_path) if run.data.tags.get(PARENT) == newest.info.run_id]
    assert len(children) == grown.runs


PARENT = "mlflow.parentRunId"


def recorded(cwd):
    return MlflowClient(tracking_uri=f"sqlite:///{cwd}/store.db").search_runs(["1"])
