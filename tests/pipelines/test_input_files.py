"""The contents of input files are part of what a sweep, a job and a checkpoint go by."""

import os

import pytest
from support.composing import composed
from support.processes import SMALL, inside, refused

from pipelines.app import flat_settings
from pipelines.provenance import contents_of


@pytest.fixture
def work(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_files_are_found_wherever_they_are_named(work):
    for name in ("a.csv", "b c.csv", "d.csv", "other.csv"):
        (work / name).write_text(name)
    named = {"pdf": {"path": "a.csv"}, "deployments": ["mine: file deployment.path=d.csv", {"path": "b c.csv"}]}
    expected = ["contents of a.csv", "contents of b c.csv", "contents of d.csv"]
    assert list(contents_of(named)) == expected
    assert list(contents_of(["pdf.path=a.csv,'b c.csv'", "recording.path=d.csv"])) == expected
    assert contents_of({"seed": 0, "path": None, "name": "e.csv"}) == {}


def test_a_file_that_no_memory_holds_is_not_read_for_it(work):
    with (work / "a.csv").open("wb") as file:
        file.truncate(1 << 43)  # takes no space
    os.mkfifo(work / "b.csv")
    assert contents_of(["a.csv", "b.csv", "/dev/zero"]) == {"contents of a.csv": f"{1 << 43} bytes"}


@pytest.mark.parametrize(
    "override",
    [
        "room.relevance.path=in.csv",
        "visibility=fiducial tag.edge=0.1 visibility.detector=in.csv",
        "pdf=samples pdf.path=in.csv",
        "deployment=file deployment.path=in.csv",
        "camera=calibration camera.path=in.csv",
        "deployment.fixed=in.csv",
    ],
)
def test_every_file_of_a_run_is_found(work, override):
    (work / "in.csv").write_text("x")
    settings = flat_settings(composed("optimise", *override.split()))
    assert list(contents_of(settings)) == ["contents of in.csv"]


@pytest.mark.slow
def test_a_run_does_not_go_on_with_another_pdf(tmp_path):
    settings = (*SMALL, "pdf=samples", "pdf.path=in.csv", "optimiser=ega", "deployment.count=20", "tracking=none")
    (tmp_path / "in.csv").write_text("yaw,pitch,weight\n0,0,0.5\n1,0,0.5\n")
    for more in (["budget.evaluations=30", "hydra.run.dir=run"], ["resume=run", "hydra.run.dir=again"]):
        done = inside("optimise", "budget.evaluations=60", *more, cwd=tmp_path, settings=settings)
        assert done.returncode == 0, done.stderr
    (tmp_path / "in.csv").write_text("yaw,pitch,weight\n0,0,0.5\n2,0,0.5\n")
    message = "checkpoint.npz was made with contents of in.csv = "
    refused("optimise", "resume=run", "hydra.run.dir=third", message=message, cwd=tmp_path, settings=settings)


def test_folders_that_cannot_be_read_are_left_to_who_reads_them(tmp_path, monkeypatch):
    (tmp_path / "a.png").write_text("pixels")
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert contents_of({"photographs": str(tmp_path)}) == {}
