"""The summary of the jobs of a sweep, by group."""

from pipelines.operations.sweeps.folder import Job, JobFolder, Sweep
from pipelines.operations.sweeps.summary import best_and_median, description


def job(fitness=None, **varied):
    varied = {key.replace("__", "."): value for key, value in varied.items()}
    status = "failed" if fitness is None else "finished"
    figures = {} if fitness is None else {"fitness": fitness}
    return JobFolder("job"), Job("s", None, 0, (), varied, status), figures


SEEDS = [job(0.5, optimiser="ega", seed="0"), job(0.7, optimiser="ega", seed="1"), job(0.6, optimiser="sga", seed="0"),
         job(None, optimiser="sga", seed="1")]  # fmt: skip
OVER_SEEDS = Sweep("s", ("optimiser", "seed"), None)
PAIRS = [job(0.1 * i + 0.2 * j, objective__n=n, objective__thold_p=p, seed=seed)
         for i, n in enumerate("23") for j, p in enumerate(("0.5", "0.65")) for seed in "01"]  # fmt: skip
OVER_PAIRS = Sweep("s", ("objective.n", "objective.thold_p", "seed"), None)


def test_jobs_that_differ_in_their_seed_are_one_group():
    assert description(OVER_SEEDS, SEEDS).splitlines() == [
        "varies: `optimiser` (2 values), `seed` (2 values)",
        "",
        "| optimiser | jobs finished | fitness: best | fitness: median |",
        "| --- | --- | --- | --- |",
        "| ega | 2 of 2 | 70.00% | 60.00% |",
        "| sga | 1 of 2 | 60.00% | 60.00% |",
    ]


def test_the_best_of_all_is_said_where_all_had_one_problem():
    assert best_and_median(OVER_SEEDS, SEEDS) == {"best/fitness": 0.7, "median/fitness": 0.6}
    assert best_and_median(OVER_PAIRS, PAIRS) == {}
    assert best_and_median(Sweep("s", ("room",), None), [job(0.5, room="lab")]) == {}
    assert best_and_median(Sweep("s", ("deployment",), None), [job(0.5, deployment="uniform")]) != {}
