"""`python -m pipelines.compare suite=...`: runs, a leaderboard, going on, refusals. One tournament takes some 5 s."""

import json
import shutil

import pandas as pd
import pytest
from processes import call, inside

pytestmark = [pytest.mark.slow, pytest.mark.long]
SMALL = ("suite=[tiny_mean,tiny_qualified]", "suite_budgets=[1]", "tracking=none", "workers=1", "validate=false")

# Longer than a folder may be called.
TUNED = (
    "ega optimiser.population=10 optimiser.eliminated=3 optimiser.recombination_min=0.3970 "
    "optimiser.recombination_max=0.8643 optimiser.mutation_probability=0.06888 optimiser.partner=survivor "
    "optimiser.acceptance=always optimiser.mutation=reset"
)


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    """A tournament of three optimisers over two problems."""
    cwd = tmp_path_factory.mktemp("tournament")
    done = call(
        "compare",
        *SMALL,
        f"optimisers=[one_plus_one,random_search,'{TUNED}']",
        "seeds=2",
        "hydra.run.dir=a",
        cwd=cwd,
        settings=(),
    )
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
    assert {"ranks_1_fitness.png", "profiles_1.png", "iohprofiler", "runs"} < left


def test_a_run_of_it_is_that_of_the_library(held):
    """Same problem, same seed, same budget, by `lmd` alone."""
    import lmd.suite
    from lmd.optimisers.ledger import Budget
    from lmd.optimisers.random_search import RandomSearch

    cwd, _ = held
    record = json.loads((cwd / "a/runs/tiny_mean/tiny_mean 80 random_search seed=1/run.json").read_text())
    problem = lmd.suite.problem("tiny_mean").problem
    assert record["metrics"]["fitness"] == RandomSearch(seed=1).run(problem, Budget(80)).fitness


def test_a_tournament_goes_on_with_more_optimisers(held):
    cwd, _ = held
    more = ("optimisers=[one_plus_one,sga]", "seeds=2", "resume=a", "hydra.run.dir=b")
    done = call("compare", *SMALL, *more, cwd=cwd, settings=())
    assert done.returncode == 0, done.stderr
    assert "4/8 done already in a" in done.stdout
    assert "one_plus_one seed" not in done.stdout
    table = pd.read_csv(cwd / "b" / "leaderboard.csv")
    assert {"one_plus_one", "sga"} < set(table)


def test_the_parts_of_a_sweep_make_a_tournament(held, tmp_path):
    cwd, _ = held
    for name in ("tiny_mean", "tiny_qualified"):
        shutil.copytree(cwd / "a" / "runs" / name, tmp_path / "parts" / name / "runs" / name)
    more = (f"optimisers=[random_search,'{TUNED}']", "seeds=2", f"resume={tmp_path / 'parts'}", "hydra.run.dir=c")
    done = call("compare", *SMALL, *more, cwd=cwd, settings=())
    assert done.returncode == 0, done.stderr
    assert "8/8 done already" in done.stdout


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (("suite=tiny_meen",), "suite must be one of"),
        (("suite=small", "room=lab"), "suite = small has frozen problems: leave room out"),
        (("suite=localised_against_tags",), "suite: localised_against_tags has several objectives"),
        (("suite=tiny_mean", "suite_budgets=[4]"), "suite_budgets must be one of 1, 2, 3, got '4'"),
        (
            ("suite=frc_cameras", "optimisers=[greedy]"),
            "optimisers: 'greedy' takes none of the problems: Greedy places",
        ),
    ],
)
def test_what_no_tournament_takes_is_refused(overrides, message, tmp_path):
    done = inside("compare", *overrides, "tracking=none", cwd=tmp_path, settings=())
    assert done.returncode == 1
    assert message in done.stderr


def test_other_commands_take_a_frozen_problem(tmp_path):
    done = inside("optimise", "suite=tiny_mean", "optimiser=random_search", "budget.evaluations=6", "picture=false",
                  "validate=false", "tracking=none", "hydra.run.dir=run", cwd=tmp_path, settings=())  # fmt: skip
    assert done.returncode == 0, done.stderr
    import lmd.suite
    from lmd.optimisers.ledger import Budget
    from lmd.optimisers.random_search import RandomSearch

    found = RandomSearch(seed=0).run(lmd.suite.problem("tiny_mean").problem, Budget(6))
    assert json.loads((tmp_path / "run" / "metrics.json").read_text())["fitness"] == found.fitness


@pytest.mark.parametrize(
    ("command", "overrides", "message"),
    [
        ("optimise", ("suite=frc_cameras",), "suite=frc_cameras places cameras: python -m pipelines.place_cameras"),
        ("optimise", ("suite=tiny_mean", "camera=lab"), "suite=tiny_mean has a frozen problem: leave camera out"),
        (
            "optimise",
            ("suite=tiny_mean", "room.spacing=2"),
            "leave room.spacing out",
        ),
        ("optimise", ("suite=coverage_against_accuracy",), "has two objectives, which no command takes"),
        ("detect", ("suite=tiny_mean",), "suite is no key of detect: it takes no frozen problem"),
        ("evaluate", ("suite=tiny",), "suite must be one of"),
    ],
)
def test_a_frozen_problem_that_a_command_cannot_take_is_refused(command, overrides, message, tmp_path):
    done = inside(command, *overrides, cwd=tmp_path, settings=())
    assert done.returncode == 1
    assert message in done.stderr
