"""Unsaved changes of the planner are kept, for every way to end it and every folder that can be written."""

import errno
import os
import shutil
import signal

import pytest
from support.chromium import LANDMARKS, SETTINGS, UNSAVED

from lmd.planner.plan import Plan
from lmd.planner.server import Planner
from lmd.scene.deployment import Deployment
from pipelines.composing import compose
from pipelines.operations.signals import Stopped
from pipelines.outputs import all_or_none
from pipelines.view import _keep_unsaved, view


def test_what_is_unsaved_is_kept_before_anything_is_waited_for(tmp_path, monkeypatch):
    kept = []

    class Ended(Planner):
        """Ends at once, with a tag deleted."""

        def run(self):
            self._session.delete(3)
            raise Stopped(signal.SIGINT)

        def close(self):
            kept.append(Deployment.from_csv(tmp_path / UNSAVED).ids.tolist())
            super().close()

    monkeypatch.setattr("lmd.planner.server.Planner", Ended)
    monkeypatch.setattr("pipelines.view.run_directory", lambda: tmp_path)
    (tmp_path / "mine.csv").write_text(LANDMARKS)
    cfg = compose("view", *SETTINGS, f"deployment.path={tmp_path}/mine.csv")
    with pytest.raises(Stopped):
        view(cfg)
    assert kept == [[7, 9, 4]]


def test_changes_are_kept_elsewhere_when_the_disk_is_full_or_gone(tmp_path, monkeypatch, capsys):
    run, temporary, to_csv = tmp_path / "run", tmp_path / "temporary", Deployment.to_csv

    def written(deployment, file, ups=False):
        if file.is_relative_to(run):
            file.write_text("id,")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(file))
        to_csv(deployment, file, ups)

    monkeypatch.setattr(Deployment, "to_csv", written)
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    tags, earlier = Deployment([[0.0, 2.0, 3.0]], [[1.0, 0.0, 0.0]]), "id,x,y,z,nx,ny,nz\n"
    temporary.mkdir()
    for is_there in (True, False):
        if is_there:
            run.mkdir()
            (run / UNSAVED).write_text(earlier)
        _keep_unsaved(run, Plan(tags), ups=False)
        (kept,) = temporary.rglob(UNSAVED)
        assert (Deployment.from_csv(kept).positions == tags.positions).all()
        err = capsys.readouterr().err
        assert f"changes that were not saved are in {kept}\n" in err
        assert str(run) in err
        kept.unlink()
        if is_there:
            assert (run / UNSAVED).read_text() == earlier
            shutil.rmtree(run)


def test_a_folder_with_the_name_of_a_file_is_no_place_to_save(tmp_path):
    (tmp_path / "landmarks.csv").mkdir()

    def write(folder):
        for name in ("a.csv", "landmarks.csv"):
            (folder / name).write_text("new")

    with pytest.raises(IsADirectoryError, match=r"landmarks\.csv"):
        all_or_none(tmp_path, write)
    assert [path.name for path in tmp_path.rglob("*")] == ["landmarks.csv"]
