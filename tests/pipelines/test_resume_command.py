"""`pipelines.runs` starts no command of a tracking store, and of a run's folder nothing that could run code."""

import os
import shlex
import sys
from pathlib import Path

import pandas as pd
import pytest
import yaml
from composing import composed
from hydra.core.hydra_config import HydraConfig

import pipelines.runs
from lmd.core.checks import InputError
from lmd.optimisers.checkpoint import CHECKPOINT_FILE
from pipelines.app import CONF
from pipelines.runs import resume_command
from pipelines.trust import Trust

STORED = "python -m pipelines.optimise optimiser._target_=os.system"


@pytest.fixture(autouse=True)
def says(monkeypatch):
    """A function that lets this process be `pipelines.runs` with some arguments."""
    instance = HydraConfig.instance()
    monkeypatch.setattr(instance, "cfg", instance.cfg)

    def say(*arguments):
        monkeypatch.setattr(sys, "argv", ["runs", *arguments])
        instance.set_config(composed("runs", *arguments, return_hydra_config=True))

    say()
    return say


@pytest.fixture
def left(tmp_path):
    """A function that leaves the folder of a run that was cut short."""

    def leave(*task, own=(), sources=(), name="optimise", sweep=False, **parts):
        hydra = {
            "job": {"name": name},
            "overrides": {"hydra": list(own), "task": list(task)},
            "runtime": {"config_sources": [{"path": CONF, "schema": "file", "provider": "main"}, *sources]},
        }
        (tmp_path / ".hydra").mkdir(exist_ok=True)
        (tmp_path / CHECKPOINT_FILE).touch()
        path = tmp_path / ("multirun.yaml" if sweep else ".hydra/hydra.yaml")
        path.write_text(yaml.safe_dump({"hydra": hydra | parts}))
        return tmp_path

    return leave


def told(folder, status="KILLED", **tags):
    """What is known of a run of a store."""
    known = {"command": STORED, "folder": str(folder), "host": "elsewhere"} | tags
    return resume_command(pd.Series({"status": status} | {f"tags.{k}": v for k, v in known.items()}), Trust.given())


def test_a_run_goes_on_by_what_hydra_wrote_into_its_folder(says, left):
    says("last=5", "tracking.uri=sqlite:///mine.db", "resume=last", "trust=[mine]", "+tracking.tags.by=you")
    task = ("optimiser=ega", "deployment.count='+5'", "tracking.uri=http://else:5000", "resume=old", "trust=[mine]",
            "tracking=mlflow", "+tracking.tags.study='a b'", "++tracking.tags.by=me")  # fmt: skip
    folder = left(*task, own=["hydra.run.dir=x", "hydra.mode=RUN", "hydra.verbose=true"])
    again = told(folder)
    arguments = ["optimiser=ega", "deployment.count='+5'", "tracking=mlflow", "+tracking.tags.study='a b'",
                 "hydra.mode=RUN", "hydra.verbose=true", "tracking.uri=sqlite:///mine.db", "trust=[mine]",
                 "+tracking.tags.by=you", f"hydra.run.dir={folder}", f"resume={folder}"]  # fmt: skip
    assert again.process == (sys.executable, "-m", "pipelines.optimise", *arguments)
    assert again.command == f"python -m pipelines.optimise {shlex.join(arguments)}"
    assert not again.why_not
    left("seed=1")
    assert told(folder).process[3:-4] == ("seed=1",)
    assert told(folder).process[-1] == f"resume={folder}"  # in a new folder, as it began in one


def test_a_sweep_goes_on_in_its_folder(left):
    own = ["hydra.mode=MULTIRUN", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2", "hydra.sweep.dir='x'"]
    folder = left("seed=0,1", own=own, sweep=True)
    assert told(folder, sweep="seed").process[3:] == ("seed=0,1", *own[:-1], f"hydra.sweep.dir={folder}")
    assert told(folder, sweep="seed", **{"mlflow.parentRunId": "3f"}) is None  # a job goes on with its sweep


@pytest.mark.parametrize(
    ("task", "why"),
    [
        ("optimiser._target_=os.system", "optimiser._target_ = 'os.system' would run code"),
        ("optimiser={_target_: os.system, command: x}", "optimiser._target_ = 'os.system'"),
        ("+camera.rig=[{camera: {_target_: os.system}}]", "camera.rig.0.camera._target_ = 'os.system'"),
        ("optimiser={_target_: os.system},{a: 1}", "is not taken from a file"),
        ("optimiser._target_=os.system,os.popen", "is not taken from a file"),
        ("seed=${oc.env:HOME}", "add trust=[oc.env]"),
        ("seed=1,${oc.env:HOME}", "add trust=[oc.env]"),
        ("tag.family=extend_list(a)", "which is no override"),
        ("hydra.callbacks.a._target_=os.system", "is not taken from a file"),
        ("+room@hydra.callbacks.a=lab", "is not taken from a file"),
        ("~hydra.callbacks", "is not taken from a file"),
        ("save_as=/etc/passwd", "is not taken from a file"),
        ("room=../../evil", "is not taken from a file"),
        ("room=lab,../../evil", "is not taken from a file"),
        ("optimisers=['ega ~room +room={_target_:numpy.load}']", "is not taken from a file"),
        ("deployments=['uniform room=../../evil']", "is not taken from a file"),
        ("kept=/etc", "is not taken from a file"),
        ("trust=[os]", "it was told trust=['os']"),
        ("+tracking.tags.a=${oc.env:HOME}", "add trust=[oc.env]"),
        ("--config-dir=evil", "which is no override"),
        ("--experimental-rerun=evil.pickle", "which is no override"),
        ("seed=1; touch imported", "which is no override"),
        ("tag.family='1; touch imported'", None),  # one argument of no shell
        (["seed=1"], "is not written as Hydra writes it"),
    ],
)
def test_what_a_stranger_may_have_written_is_shown_and_not_run(left, task, why):
    again = told(left(task))
    if why is None:
        assert task in again.process
        return
    assert not again.process
    assert why in again.why_not
    assert again.command.startswith(f"{STORED} resume=")


@pytest.mark.parametrize(
    "own",
    [
        "hydra.searchpath=[file://evil]", "hydra.job.env_set.PATH=evil", "+hydra.callbacks.a._target_=evil.C",
        "hydra.launcher.setup=[evil]", "hydra.launcher.python=evil", "hydra.launcher.partition='a\n#SBATCH b'",
        "hydra/sweeper=evil", "hydra.sweeper.params={}", "hydra.job_logging.handlers.a.class=evil",
        "hydra.output_subdir=/",
    ],
)  # fmt: skip
def test_hydras_own_settings_are_not_taken_from_a_file(left, own):
    source = {"path": "evil", "schema": "file", "provider": "hydra.searchpath in command-line"}
    again = told(left(own=[own], sources=[source] if "searchpath" in own else ()))
    assert not again.process
    assert again.why_not.isprintable()


@pytest.mark.parametrize("search", ["hydra.searchpath=[file://{}]", "--config-dir={}"])
def test_a_run_with_ones_own_optimiser_goes_on_where_the_search_path_is_given_again(says, left, tmp_path, search):
    """As in CONTRIBUTING.md."""
    own, given = tmp_path / "mine", search.format(tmp_path / "mine")
    (own / "optimiser").mkdir(parents=True)
    (own / "optimiser" / "hill.yaml").write_text("_target_: climbing.HillClimber\n")
    source = {"path": str(own), "schema": "file", "provider": "command-line"}
    left("optimiser=hill", own=[given] if given.startswith("hydra") else [], sources=[source])
    again = told(tmp_path)
    assert not again.process
    assert f"add 'hydra.searchpath=[file://{own}]'" in again.why_not
    says(f"hydra.searchpath=[file://{own}]")
    assert told(tmp_path).process[3:5] == (f"hydra.searchpath=[file://{own}]", "optimiser=hill")
    left("optimiser._target_=climbing.HillClimber", sources=[source])
    assert told(tmp_path).process


@pytest.mark.parametrize("name", ["sync", "runs", "report", "os", "../conf/optimise", "none", "", "o\x1b[2Jp"])
def test_only_what_can_be_cut_short_goes_on(left, name):
    again = told(left(name=name))
    assert not again.process
    assert "which is no pipeline" in again.why_not
    assert again.why_not.isprintable()


def test_a_folder_that_leads_elsewhere_does_not_go_on(left, tmp_path):
    folder = left()
    (folder / ".hydra" / "config.yaml").symlink_to(tmp_path / "precious")
    again = told(folder)
    assert not again.process
    assert "config.yaml is a link" in again.why_not


def test_pickles_of_a_sweep_are_not_read(left):
    folder = left("seed=0,1", own=["hydra/launcher=submitit_local"], sweep=True)
    assert told(folder, sweep="seed").process
    (folder / ".submitit" / "1").mkdir(parents=True)
    again = told(folder, sweep="seed")
    assert not again.process
    assert ".submitit holds what jobs and the sweep hand to each other, which may run code" in again.why_not


@pytest.mark.parametrize("text", ["", "[1]", "hydra: 1", "hydra: {job: 1}", "a: [", "hydra: {job: {name: optimise}}"])
def test_a_folder_that_hydra_has_not_written_does_not_go_on(left, text):
    folder = left()
    file = folder / ".hydra" / "hydra.yaml"
    file.write_text(text)
    assert not told(folder).process
    assert told(folder).why_not
    file.unlink()
    os.mkfifo(file)
    assert "it is a pipe" in told(folder).why_not


def test_what_is_not_here_is_named_and_what_has_left_nothing_is_not(left, tmp_path, monkeypatch):
    again = told(tmp_path / "none", command="rm -rf ~ \x1b[2J")
    assert (again.process, again.command) == ((), "rm -rf ~ \\x1b[2J")
    assert "is not on this host" in again.why_not
    monkeypatch.setattr("socket.gethostname", lambda: "elsewhere")
    assert told(tmp_path / "none") is None
    assert told(left(), status="FINISHED") is None
    (left() / CHECKPOINT_FILE).unlink()
    assert told(tmp_path) is None


def test_resume_runs_nothing_that_is_only_shown(left, monkeypatch):
    executed = []
    monkeypatch.setattr(os, "execv", lambda *call: executed.append(call))
    folder = left("optimiser._target_=os.system")
    with pytest.raises(InputError, match=r"^resume = 'last': 3f does not go on from here: .* would run code"):
        pipelines.runs._resume({"3f": told(folder)}, "last")
    assert not executed
    left("seed=1")
    pipelines.runs._resume({"3f": told(folder)}, "3f")
    ((program, arguments),) = executed
    assert Path(program) == Path(arguments[0]) == Path(sys.executable)
