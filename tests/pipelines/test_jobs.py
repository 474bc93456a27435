"""The jobs of a sweep: their names, their records on disk, the locks on their folders."""

import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from lmd.core.checks import InputError
from lmd.optimisers.checkpoint import CHECKPOINT_FILE
from pipelines.app import key_and_value, quoted
from pipelines.operations.sweeps.folder import Job, JobFolder, Sweep, SweepFolder, reason_of
from pipelines.operations.sweeps.names import job_folder, slug, varied_keys
from pipelines.outputs import RunDirectory, held, locks


def test_names():
    assert slug("n-2_path-out/a b,c=d.csv") == "n-2_path-out-a-b-c-d.csv"  # needs no quotes in an override
    assert quoted(Path("it's a\\b")) == r"'it\'s a\\b'"
    overrides = ["optimiser=ega,sga", "+a@b.c=d,e", "objective.n=2", "seed=range(3)", "room.size=[1,2,3]"]
    assert varied_keys(overrides) == ("optimiser", "a@b.c", "seed")
    assert key_and_value("+room.note=a=b") == ("room.note", "a=b")
    assert JobFolder("job").checkpoint.name == CHECKPOINT_FILE


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (InputError("n = 0 is too few."), "n = 0 is too few."),
        (ValueError("two\nlines"), "ValueError: two lines"),
        (MemoryError(), "MemoryError"),
        (SystemExit(3), "exited with code 3 before it had finished"),
        (SystemExit(), "exited with code 0 before it had finished"),
        (SystemExit("no licence"), "no licence"),
    ],
)
def test_a_reason_is_one_line(error, reason):
    assert reason_of(error) == reason


def test_a_sweep_lists_what_was_asked_last_and_what_had_finished_before(tmp_path):
    folder = SweepFolder(tmp_path / "seed")
    folder.save(Sweep("seed", ("seed",), None, round=1))
    asked = {
        "old": ("finished", 0, 0),
        "gave up": ("failed", 1, 0),
        "new": ("failed", 1, 1),
        "first": ("running", 0, 1),
    }
    for name, (status, number, round_) in asked.items():
        (folder.path / name).mkdir()
        JobFolder(folder.path / name).save(Job("seed", None, number, (), {}, status, round=round_))
    assert [its_folder.name for its_folder, _ in folder.jobs()] == ["first", "new", "old"]


def test_a_job_has_one_folder_whatever_varies_beside_it(tmp_path):
    hydra = {"sweep": {"dir": str(tmp_path)}, "overrides": {"task": ["objective.n=2", "seed=0"]}}
    root = OmegaConf.create({"objective": {"n": 2}, "seed": 0, "hydra": hydra})
    SweepFolder(tmp_path).save(Sweep("n", ("objective.n",), None))
    name = job_folder(_root_=root)
    assert name.startswith("n-2_")
    (tmp_path / name).mkdir()
    SweepFolder(tmp_path).save(Sweep("n_seed", ("objective.n", "seed"), None))
    assert job_folder(_root_=root) == name
    root.seed = 1
    assert job_folder(_root_=root) != name


def test_a_run_is_refused_in_a_folder_where_another_one_works(tmp_path):
    config = {"hydra": {"run": {"dir": str(tmp_path / "run")}, "job": {"name": "optimise"}}, "resume": str(tmp_path)}
    with held(tmp_path), closing(locks), pytest.raises(SystemExit) as refused:
        RunDirectory().on_run_start(OmegaConf.create(config))
    assert refused.value.code == f"error: resume: another process is at work in '{tmp_path}'."
    with closing(locks):
        RunDirectory().on_run_start(OmegaConf.create(config))  # the lock is free again


@pytest.mark.slow
def test_a_folder_is_held_by_one_process_and_the_child_that_inherits_it(tmp_path):
    with held(tmp_path) as lock:
        assert lock is not None
        child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE, pass_fds=(lock,))
        with held(tmp_path, wait=False) as second:
            assert second is None
    with held(tmp_path, wait=False) as second:
        assert second is None
    child.communicate(b"\n")
    with held(tmp_path, wait=False) as second:
        assert second is not None
