"""The summary of the jobs of a sweep, by group."""

from pipelines.operations.sweeps.folder import Job, JobFolder, Sweep
from pipelines.operations.sweeps.names import short_name
from pipelines.operations.sweeps.summary import Outcome, best_group, by_group, draw_groups


def job(fitness=None, off_grid=None, **varied):
    varied = {key.replace("__", "."): value for key, value in varied.items()}
    status = "failed" if fitness is None else "finished"
    figures = {key: value for key, value in {"fitness": fitness, "off_grid": off_grid}.items() if value is not None}
    return Outcome(JobFolder("job"), Job("s", None, 0, (), varied, status), figures)


SEEDS = [job(0.5, optimiser="ega", seed="0"), job(0.7, optimiser="ega", seed="1"), job(0.6, optimiser="sga", seed="0"),
         job(None, optimiser="sga", seed="1")]  # fmt: skip
OVER_SEEDS = Sweep("s", ("optimiser", "seed"), None)
PAIRS = [job(0.1 * i + 0.2 * j, 0.1 * i, objective__n=n, optimiser=name, seed=seed)
         for i, n in enumerate("23") for j, name in enumerate(("ega", "sga")) for seed in "01"]  # fmt: skip
OVER_PAIRS = Sweep("s", ("objective.n", "optimiser", "seed"), None)


def test_jobs_that_differ_in_their_seed_are_one_group():
    table = [
        "| optimiser | jobs finished | fitness: best | fitness: median |",
        "| --- | --- | --- | --- |",
        "| ega | 2 of 2 | 70.00% | 60.00% |",
        "| sga | 1 of 2 | 60.00% | 60.00% |",
    ]
    assert by_group(OVER_SEEDS, SEEDS).splitlines() == table


def test_figures_are_over_seeds_alone():
    assert best_group(OVER_SEEDS, SEEDS) == {"best/fitness": 0.7, "median/fitness": 0.6}  # of ega, the best
    assert best_group(OVER_PAIRS, PAIRS) == {}
    for key in ("experiment", "room", "run", "objective.thold_p", "deployment.count", "deployment.fixed"):
        of_both = [job(0.5, **{key.replace(".", "__"): value}) for value in ("debug", "hall")]
        assert best_group(Sweep("s", (key,), None), of_both) == {}


def test_the_picture_of_groups_is_of_finished_searches(tmp_path):
    found = [each._replace(folder=JobFolder(tmp_path / str(i))) for i, each in enumerate(SEEDS)]
    assert draw_groups(tmp_path / "groups.png", OVER_SEEDS, found) == []
    for folder, _, figures in found[:3]:
        folder.path.mkdir()
        (folder.path / "history.csv").write_text(
            f"evaluations,best_fitness,wall_time\n1,0.1,0.2\n9,{figures['fitness']},1\n"
        )
    assert draw_groups(tmp_path / "groups.png", OVER_SEEDS, found) == [tmp_path / "groups.png"]
    assert (tmp_path / "groups.png").stat().st_size > 10_000


def test_a_pivot_has_the_method_across_and_the_problem_down():
    assert by_group(OVER_PAIRS, PAIRS).splitlines()[:6] == [
        "Medians over seeds, on the grid and off it:",
        "",
        "| objective.n | optimiser=ega | optimiser=sga |",
        "| --- | --- | --- |",
        "| 2 | 0.00% (0.00% off the grid) | 20.00% (0.00% off the grid) |",
        "| 3 | 10.00% (10.00% off the grid) | 30.00% (10.00% off the grid) |",
    ]


def test_the_name_of_a_run_begins_with_what_varies():
    varied = ["objective.n=4", "objective.thold_p=0.7", "optimiser=ega", "seed=1", "threads=1"]
    assert short_name("ega", varied) == "ega n=4 p=0.7 s1"
    assert short_name("annealing", [*varied[:2], "seed=1"]) == "n=4 p=0.7 s1 annealing"
    assert short_name("ega", ["deployment.path='out/a b.csv'"]) == "path=a b.csv ega"
    assert short_name("ega", []) == "ega"
    assert short_name("ega", varied, ["room=hall", "validate=false"]) == "ega n=4 p=0.7 s1 room=hall"
    assert short_name("annealing", [f"room.note={'x' * 100}"]) == f"note={'x' * 65} annealing"
