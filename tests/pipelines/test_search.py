"""A search over the parameters of an optimiser: jobs of a sweep that nevergrad proposes."""

import csv
from dataclasses import replace

import pytest
from processes import call

import lmd.suite
from lmd.core.checks import InputError
from pipelines.operations.sweeps.search import _scaled

pytestmark = pytest.mark.slow
SEARCH = (
    *("experiment=debug", "hparams_search=ega", "hydra/sweeper=search", "deployment.count=6", "budget.evaluations=31"),
    "picture=false",
    # The first proposal is in the middle, the second above it: from 30 on nothing would survive.
    *(
        "optimiser.population=30",
        "optimiser.eliminated=int(interval(0,58))",
        "optimiser.mutation_probability=0.1",
        "hydra.sweeper.seed=4",
    ),
)


def search(cwd, *overrides):
    return call("optimise", *SEARCH, *overrides, cwd=cwd, settings=())


def jobs(cwd):
    (table,) = cwd.glob("outputs/optimise_sweep/debug_ega-*/jobs.csv")
    return list(csv.DictReader(table.open()))


def test_a_search_survives_failed_trials_finds_its_finished_ones_and_grows(tmp_path):
    """Eight short jobs, five seconds."""
    first = search(tmp_path, "hydra.sweeper.trials=2", "seed=0,1")
    before = jobs(tmp_path)
    assert [row["seed"] for row in before] == ["0", "1"] * 2
    assert {row["status"] for row in before} == {"finished", "failed"}
    assert all((int(row["optimiser.eliminated"]) >= 30) == (row["status"] == "failed") for row in before)
    assert first.returncode == 1  # as with any sweep of which a job failed
    assert "best of 2 trials: " in first.stdout  # both have been run by then
    assert "optimiser.eliminated = " in first.stderr
    again = search(tmp_path, "hydra.sweeper.trials=3", "seed=0,1")
    finished = [row for row in before if row["status"] == "finished"]
    assert again.stdout.count("done already") == len(finished)
    after = jobs(tmp_path)
    assert len(after) == 6
    assert all(row in after for row in finished)


def test_a_trial_solves_all_problems_of_the_suite(tmp_path):
    """Four short jobs, four seconds; the sentence has the mean of fractions of the best values known."""
    given = ("hparams_search=ega", "suite=tiny_mean,tiny_qualified", "seed=0", "budget.evaluations=31")
    done = call("optimise", *given, "hydra.sweeper.trials=2", "tracking=none", cwd=tmp_path, settings=())
    assert done.returncode == 0, done.stderr
    (table,) = tmp_path.glob("outputs/optimise_sweep/ega-*/jobs.csv")
    rows = list(csv.DictReader(table.open()))
    assert [row["suite"] for row in rows] == ["tiny_mean", "tiny_qualified"] * 2
    known = {name: lmd.suite.document(name).best.value for name in ("tiny_mean", "tiny_qualified")}
    values = [float(row["fitness"]) / known[row["suite"]] for row in rows]
    best = max(sum(values[:2]), sum(values[2:])) / 2
    assert f" trials: {best:.2%} of the best values known with " in done.stdout


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["hydra.sweeper.trials=0", "seed=0,1"], "error: hydra.sweeper: trials must be at least 1"),
        (["hydra.sweeper.method=GNOpt", "optimiser.eliminated=2,3"], "error: hydra.sweeper: method must be one of"),
        (["seed=0,1"], "error: hydra.sweeper: a search needs keys that vary"),
    ],
)
def test_a_search_that_cannot_begin_says_why_and_leaves_nothing(tmp_path, overrides, message):
    start = ("experiment=debug", "optimiser=ega", "hydra/sweeper=search", "hydra.mode=MULTIRUN")
    done = call("optimise", *start, *overrides, cwd=tmp_path, settings=())
    assert done.returncode == 1
    assert message in done.stderr
    assert not list(tmp_path.glob("outputs/optimise_sweep/*"))


def test_problems_without_a_best_value_have_no_common_scale(monkeypatch):
    unknown = replace(lmd.suite.document("tiny_mean"), best=None)
    monkeypatch.setattr(lmd.suite, "document", {"tiny_mean": unknown}.get)
    with pytest.raises(InputError, match=r"^suite: no best value is known of 'tiny_mean', so"):
        _scaled(["tiny_mean"], "fitness")
