"""Documents that are damaged, and those that are written while something fails."""

import os

import pytest

from pipelines.operations.sweeps.folder import Job, JobFolder, Sweep, SweepFolder
from pipelines.outputs import read_document, write_document

JOB = Job("table2", None, 3, ("seed=3",), {"seed": "3"}, "finished", 0.5)
DAMAGES = {
    "empty": "",
    "cut": '{"sweep": "tab',
    "zeros": "\0" * 40,
    "list": "[]",
    "other": '{"a": 1}',
    "deep": "[" * 10**5,
}


@pytest.fixture
def job(tmp_path):
    folder = JobFolder(tmp_path / "job")
    folder.path.mkdir()
    folder.save(JOB)
    write_document(folder.metrics, {"fitness": 0.5})
    return folder


def test_what_is_written_is_read(job, tmp_path):
    sweep, saved = SweepFolder(tmp_path), Sweep("table2", ("seed",), "3f2a")
    sweep.save(saved)
    assert sweep.load() == saved
    assert job.load() == job.finished() == JOB
    assert [found for _, found in sweep.jobs()] == [JOB]
    assert sorted(path.name for path in job.path.iterdir()) == ["job.json", "metrics.json"]


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_damaged_is_named_and_set_aside(damage, job, tmp_path, capsys):
    for path in (job.record, tmp_path / "sweep.json"):
        path.write_text(DAMAGES[damage])
    assert (job.load(), job.finished(), SweepFolder(tmp_path).load()) == (None, None, None)
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith(f"warning: {job.record} is damaged (")
    assert second.endswith("; it is kept as sweep.json.damaged, and its content is computed again")
    assert (job.path / "job.json.damaged").read_text() == DAMAGES[damage]


def test_a_pipe_is_no_document_and_is_not_waited_for(job):
    job.record.unlink()
    os.mkfifo(job.record)
    assert job.load() is None


def test_a_job_whose_figures_are_damaged_has_not_finished(job, capsys):
    job.metrics.write_text('{"fitness": 0.')
    assert job.finished() is None
    assert f"warning: {job.metrics} is damaged" in capsys.readouterr().err
    assert job.figures() == {}


def test_where_there_is_no_folder_there_is_no_document(tmp_path):
    (tmp_path / "file").touch()
    assert read_document(tmp_path / "file" / "job.json", dict) is None
    assert read_document(tmp_path / "none" / "job.json", dict) is None
