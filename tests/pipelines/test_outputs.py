"""A folder that cannot be written to, or holds an earlier run, is reported before Hydra writes to it."""

from contextlib import closing

import pytest
from omegaconf import OmegaConf

from pipelines.outputs import RunDirectory, locks


@pytest.mark.parametrize(
    ("below", "writable", "reason"),
    [("file/run", True, "file is no folder"), ("folder/run", False, "folder cannot be written to")],
)
def test_a_run_that_cannot_be_written_does_not_begin(tmp_path, monkeypatch, below, writable, reason):
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    monkeypatch.setattr("os.access", lambda *_: writable)  # root may write anywhere
    with pytest.raises(SystemExit) as ended:
        RunDirectory().on_run_start(OmegaConf.create({"hydra": {"run": {"dir": str(tmp_path / below)}}}))
    assert ended.value.code == f"error: {tmp_path / below}: {tmp_path}/{reason}"


def begin(folder, command="optimise", **settings):
    job = {"run": {"dir": str(folder)}, "job": {"name": command}}
    with closing(locks):  # as a command that has ended
        RunDirectory().on_run_start(OmegaConf.create({"hydra": job, **settings}))


@pytest.mark.parametrize(
    ("command", "result"),
    [("optimise", "metrics.json"), ("evaluate", "metrics.json"), ("compare", "comparison.csv"),
     ("tradeoff", "tradeoff.json")],
)  # fmt: skip
def test_a_run_does_not_overwrite_an_earlier_one(tmp_path, monkeypatch, command, result):
    begin(tmp_path / "new", command)
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / result).write_text("{}")
    with pytest.raises(SystemExit) as ended:
        begin(tmp_path / "old", command, resume=None)
    message = f"error: hydra.run.dir: '{tmp_path}/old' holds {result} of an earlier run: name another folder, "
    assert ended.value.code == f"{message}or delete this one, or go on with resume=DIR."
    with pytest.raises(SystemExit):
        begin(tmp_path / "old", command, resume=str(tmp_path / "new"))
    begin(tmp_path / "old", command, resume=str(tmp_path / "old"))
    begin(tmp_path / "old", "export")  # which adds files of other names
    monkeypatch.setenv("LMD_JOB", str(tmp_path / "old"))
    begin(tmp_path / "old", command)  # a job that is done again
