"""Sweeps as a user meets them: what they leave, what a failing job does to the others, and doing what is missing."""

import base64
import json
import re
import zlib

import pandas as pd
import pytest
from faulty_sweeps import prepared, runs, statuses, sweep, table, told_by
from mlflow import MlflowClient
from processes import call

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def faulty(tmp_path_factory):
    """A sweep of four jobs under joblib, three of which fail."""
    cwd = prepared(tmp_path_factory.mktemp("faulty"))
    return cwd, sweep(cwd, "none,raise,exit,kill", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2")


def test_failing_jobs_do_not_lose_the_others_and_the_sweep_names_them(faulty):
    cwd, done = faulty
    assert done.returncode == 1
    assert "1 of 4 jobs finished" in done.stdout
    assert "failed: optimiser.fault=raise: ValueError: no such luck" in done.stderr
    assert "failed: optimiser.fault=exit: exited with code 3 before it had finished" in done.stderr
    assert "killed: optimiser.fault=kill: killed by SIGKILL" in done.stderr
    rows = table(cwd)
    assert rows.status.to_dict() == {"none": "finished", "raise": "failed", "exit": "failed", "kill": "killed"}
    assert rows.qualified_ratio.notna().to_dict() == {"none": True, "raise": False, "exit": False, "kill": False}
    left = json.loads((cwd / "outputs/optimise_sweep" / folder(cwd) / rows.folder["none"] / "metrics.json").read_text())
    assert left["qualified_ratio"] == rows.qualified_ratio["none"]


def artifacts(client, run):
    return [file.path for file in client.list_artifacts(run.info.run_id)]


def folder(cwd):
    (path,) = (cwd / "outputs" / "optimise_sweep").iterdir()
    return path.name


def test_a_pipeline_without_threads_is_swept_under_joblib_too(tmp_path):
    overrides = ("hydra.mode=MULTIRUN", "simulate={}", "seed=1", "tracking=none", "hydra/launcher=joblib")
    done = call("estimate_pdf", *overrides, cwd=tmp_path, settings=())
    assert done.returncode == 0, done.stderr
    (table,) = tmp_path.glob("outputs/estimate_pdf_sweep/*/jobs.csv")
    assert pd.read_csv(table).status.tolist() == ["finished"]


def test_a_sweep_is_one_parent_run_with_a_child_for_each_job(faulty):
    cwd, done = faulty
    out = done.stdout
    parent, children = runs(cwd)
    assert parent.info.run_name.startswith("fault ")
    assert parent.info.run_name.endswith(f" count=20 evaluations=400 optimiser=faulty #{parent.info.run_id[:4]}")
    assert (parent.data.params["optimiser"], parent.data.params["objective.n"]) == ("faulty", "2")
    assert "optimiser.fault" not in parent.data.params
    told = told_by(parent)
    figure = f"{table(cwd).qualified_ratio['none']:.2%}"
    best = f"1 of 4 jobs finished; best: `fault=none`: {figure}, one job; by group: artifact `by_group.md`"
    assert told.startswith(f"**FAILED**: 3 of 4 jobs failed\n\n{best}\n\nvaries: `optimiser.fault` (4 values)\n")
    assert re.search(r"\n\| none \| 1 of 1 \| [\d.]+% \| [\d.]+% \|\n\| raise \| 0 of 1 \|  \|  \|\n", told)
    assert parent.info.status == "FAILED"
    assert parent.data.tags["reason"] == "3 of 4 jobs failed"
    assert parent.data.tags["override.optimiser.fault"] == "none,raise,exit,kill"
    assert (parent.data.metrics["jobs"], parent.data.metrics["failed"]) == (4.0, 3.0)
    assert parent.data.metrics["median/qualified_ratio"] == table(cwd).qualified_ratio["none"]  # of the best group
    client = MlflowClient(tracking_uri=f"sqlite:///{cwd}/store.db")
    assert artifacts(client, parent) == ["by_group.md", "groups.png", "jobs.csv"]
    assert f"/runs/{parent.info.run_id}?workflowType=machine_learning" in out
    for mode in ("TABLE", "CHART"):  # views of the jobs, grouped by what varies
        assert (
            f"/runs?workflowType=machine_learning&compareRunsMode={mode}&viewStateShareKey={parent.info.run_id}" in out
        )
    shared = client.get_experiment("1").tags[f"mlflow.sharedViewState.{parent.info.run_id}"]
    view = json.loads(zlib.decompress(base64.b64decode(shared.removeprefix("deflate;"))))
    assert view["groupBy"]["groupByKeys"] == [{"mode": "param", "groupByData": "optimiser.fault"}]
    assert view["columnOrder"][1:4] == ["params.`optimiser.fault`", "params.`seed`", "metrics.`off_grid`"]
    assert view["selectedColumns"] == view["columnOrder"][1:]
    assert statuses(children) == {"none": ["FINISHED"], "raise": ["FAILED"], "exit": ["FAILED"], "kill": ["FAILED"]}
    reasons = {fault: found[0].data.tags.get("reason") for fault, found in children.items()}
    assert reasons == {
        "none": None,
        "raise": "ValueError: no such luck",
        "exit": "exited with code 3 before it had finished",
        "kill": "killed by SIGKILL",
    }


def test_a_child_says_what_it_is(faulty):
    cwd, _ = faulty
    _, children = runs(cwd)
    (child,) = children["none"]
    assert child.info.run_name.startswith("fault=none faulty ")
    assert child.info.run_name.endswith(f" count=20 evaluations=400 #{child.info.run_id[:4]}")
    assert children["kill"][0].info.run_name.startswith(("fault=kill faulty", "fault=kill killed"))
    assert {found[0].data.params["deployment.count"] for found in children.values()} == {"20"}  # of failed jobs, too
    tags, params = child.data.tags, child.data.params
    assert (tags["sweep"], tags["pipeline"], tags["choice.optimiser"]) == ("optimiser.fault", "optimise", "faulty")
    assert tags["job"] == table(cwd).folder["none"]
    assert tags["override.deployment.count"] == params["deployment.count"] == "20"
    assert (params["optimiser"], params["optimiser.fault"]) == ("faulty", "none")
    client = MlflowClient(tracking_uri=f"sqlite:///{cwd}/store.db")
    assert all("output.log" in artifacts(client, found[0]) for found in children.values())
    curve = client.get_metric_history(child.info.run_id, "best_fitness")
    assert [point.step for point in curve][:6] == [1, 2, 4, 5, 8, 10]
    assert {point.value for point in curve} == {curve[0].value}  # nothing is better than the first evaluation


def test_jobs_that_share_a_machine_have_one_thread_each(faulty):
    cwd, _ = faulty
    (output,) = cwd.glob("outputs/optimise_sweep/*/fault-none_*/output.log")
    assert "threads 1 1 1\n" in output.read_text()


def test_the_same_sweep_again_does_only_what_is_missing(faulty):
    cwd, _ = faulty
    untouched = table(cwd).folder["none"]
    before = (cwd / "outputs/optimise_sweep" / folder(cwd) / untouched / "metrics.json").stat().st_mtime_ns
    (cwd / "repaired").touch()
    damaged = cwd / "outputs/optimise_sweep" / folder(cwd) / table(cwd).folder["raise"] / "job.json"
    damaged.write_text(damaged.read_text()[:100])
    again = sweep(cwd, "none,raise,exit,kill")
    assert again.returncode == 0, again.stderr
    assert f"warning: {damaged.relative_to(cwd)} is damaged (JSONDecodeError" in again.stderr
    assert "going on after 1 finished jobs" in again.stdout
    assert "done already: optimiser.fault=none" in again.stdout
    assert again.stdout.count("finished in") == 3
    assert (table(cwd).status == "finished").all()
    assert (cwd / "outputs/optimise_sweep" / folder(cwd) / untouched / "metrics.json").stat().st_mtime_ns == before
    parent, children = runs(cwd)
    assert parent.info.status == "FINISHED"
    assert "reason" not in parent.data.tags
    assert statuses(children)["none"] == ["FINISHED"]
    assert statuses(children) == {key: ["FINISHED"] for key in ("none", "raise", "exit", "kill")}  # none of before


def test_glob_finds_what_the_command_line_adds_and_the_command_of_a_job_names_no_folder_of_the_sweep(tmp_path):
    (tmp_path / "mine" / "optimiser").mkdir(parents=True)
    for name, target in {"x_one": "random_search.RandomSearch", "x_two": "sga.SGA"}.items():
        (tmp_path / "mine" / "optimiser" / f"{name}.yaml").write_text(f"_target_: lmd.optimisers.{target}\n")
    store = f"tracking.uri=sqlite:///{tmp_path}/store.db"
    added = ("hydra.mode=MULTIRUN", f"hydra.searchpath=[file://{tmp_path}/mine]", "budget.evaluations=40", store)
    done = call("optimise", *added, "optimiser=glob(x_*)", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "2 of 2 jobs finished" in done.stdout
    found = MlflowClient(tracking_uri=f"sqlite:///{tmp_path}/store.db").search_runs(["1"], "tags.job != ''")
    commands = [run.data.tags["command"] for run in found]
    assert sorted(re.search(r"optimiser=(\S+)", command)[1] for command in commands) == ["x_one", "x_two"]
    assert not any("run.dir" in command or "resume" in command for command in commands)
    assert all("hydra.mode=RUN" in command for command in commands)


@pytest.mark.parametrize("nothing", ["optimiser=glob(zz_*)", "seed=range(3,3)"])
def test_a_sweep_without_jobs_is_refused(nothing, tmp_path):
    done = call("optimise", "hydra.mode=MULTIRUN", nothing, "tracking=none", cwd=tmp_path)
    assert done.returncode == 1
    assert f"error: {nothing} has no values, so that there is nothing to run." in done.stderr
    assert not list(tmp_path.glob("outputs/*/*"))
