"""`python -m pipelines.compare`: runs, tables, what is kept, a leaderboard, refusals."""

import json

import pandas as pd
import pytest
from support.processes import inside

pytestmark = [pytest.mark.slow, pytest.mark.long]
SUITE = ("suite=[tiny_mean,tiny_qualified]", "suite_budgets=[1]", "tracking=none", "workers=1", "validate=false")
# Longer than a folder may be called.
TUNED = (
    "ega optimiser.population=10 optimiser.eliminated=3 optimiser.recombination_min=0.3970 "
    "optimiser.recombination_max=0.8643 optimiser.mutation_probability=0.06888 optimiser.partner=survivor "
    "optimiser.acceptance=always"
)


def call(*overrides, cwd):
    return inside("compare", *overrides, cwd=cwd, settings=())


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    """A tournament of three optimisers over two problems."""
    cwd = tmp_path_factory.mktemp("tournament")
    three = f"optimisers=[one_plus_one,random_search,'{TUNED}']"
    done = call(*SUITE, three, "seeds=2", "hydra.run.dir=a", cwd=cwd)
    assert done.returncode == 0, done.stderr
    return cwd, done.stdout


def test_a_tournament_has_a_leaderboard(held):
    cwd, out = held
    assert f"12/12 tiny_qualified 80 {TUNED} seed=1" in out
    table = pd.read_csv(cwd / "a" / "leaderboard.csv", index_col="problem")
    assert set(table.index) == {"tiny_mean", "tiny_qualified"}
    assert {"one_plus_one", "random_search", TUNED} < set(table)
    text = (cwd / "a" / "leaderboard.md").read_text()
    assert "Friedman's test over 2 problems" in text
    assert f"**{table.loc['tiny_mean', ['one_plus_one', 'random_search', TUNED]].max():.2%}**" in text
    assert "With 2 seeds p is at least 0.33, so no difference can reach p < 0.05; 4 seeds can." in text
    left = {path.name for path in (cwd / "a").iterdir()}
    assert {"iohprofiler", "runs"} < left


def test_a_run_of_it_is_that_of_the_library(held):
    """Same problem, same seed, same budget, by `lmd` alone."""
    import lmd.suite
    from lmd.optimisers.genetic import RandomSearch
    from lmd.optimisers.ledger import Budget

    records = [json.loads(path.read_text()) for path in (held[0] / "outputs/compare/kept").iterdir()]
    (record,) = (each for each in records if each["name"] == "tiny_mean 80 random_search seed=1")
    result = RandomSearch(seed=1).run(lmd.suite.problem("tiny_mean").problem, Budget(80))
    assert record["metrics"]["fitness"] == result.fitness
    files = held[0] / "a/runs/tiny_mean/tiny_mean 80 random_search seed=1"
    assert {path.name: path.read_text() for path in files.iterdir()} == record["files"]


def test_it_goes_on_with_more_optimisers_and_repeats_nothing_but_what_is_damaged(held):
    cwd, _ = held
    kept = {path: path.stat().st_mtime_ns for path in (cwd / "outputs/compare/kept").iterdir()}
    damaged = next(path for path in kept if "tiny_mean 80 one_plus_one seed=0" in path.read_text())
    damaged.write_text("{")
    done = call(*SUITE, "optimisers=[one_plus_one,sga]", "seeds=2", "hydra.run.dir=b", cwd=cwd)
    assert done.returncode == 0, done.stderr
    assert f"{damaged.name} is damaged" in done.stderr
    assert {path for path in kept if path.stat().st_mtime_ns != kept[path]} == {damaged}
    tables = [pd.read_csv(cwd / name / "leaderboard.csv", index_col="problem") for name in "ab"]
    assert tables[0].one_plus_one.tolist() == tables[1].one_plus_one.tolist()
    assert "sga" in tables[1]
