"""A folder without write permission is reported before Hydra writes to it."""

import pytest
from omegaconf import OmegaConf

from pipelines.outputs import RunDirectory


@pytest.mark.parametrize(
    ("below", "writable", "reason"),
    [("file/run", True, "file is no folder"), ("folder/run", False, "folder cannot be written to")],
)
def test_a_run_that_cannot_be_written_does_not_begin(tmp_path, monkeypatch, capsys, below, writable, reason):
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    monkeypatch.setattr("os.access", lambda *_: writable)  # root may write anywhere
    with pytest.raises(SystemExit) as ended:
        RunDirectory().on_run_start(OmegaConf.create({"hydra": {"run": {"dir": str(tmp_path / below)}}}))
    assert ended.value.code == 1
    assert capsys.readouterr().err == f"error: {tmp_path / below}: {tmp_path}/{reason}\n"
