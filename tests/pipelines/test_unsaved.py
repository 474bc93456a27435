"""Unsaved changes of the planner are kept, for every way to end it and every folder that can be written."""

import errno
import os
import shutil
import signal
from pathlib import Path

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
    mine = write_lines(tmp_path / "mine.csv", LANDMARKS.splitlines())
    cfg = compose("view", *SETTINGS, f"deployment.path={mine}")
    with pytest.raises(Stopped):
        view(cfg)
    assert kept == [[7, 9, 4]]


def full(path):
    """Writes something, and finds the disk full."""
    Path(path).write_text("id,")
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


def on_full_disks(monkeypatch, *disks):
    """Let no deployment be written below some folders."""
    to_csv = Deployment.to_csv

    def written(deployment, file, ups=False):
        if isinstance(file, Path) and any(file.is_relative_to(disk) for disk in disks):
            full(file)
        to_csv(deployment, file, ups)

    monkeypatch.setattr(Deployment, "to_csv", written)


def folders(tmp_path, monkeypatch):
    """A run's directory, and that to which changes go that cannot be written there."""
    made = _, temporary = tmp_path / "run", tmp_path / "temporary"
    for folder in made:
        folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    return made


def test_changes_are_kept_elsewhere_when_the_disk_is_full_or_gone(tmp_path, monkeypatch, capsys):
    run, temporary = folders(tmp_path, monkeypatch)
    tags, earlier = Deployment([[0.0, 2.0, 3.0]], [[1.0, 0.0, 0.0]]), "id,x,y,z,nx,ny,nz\n"
    (run / UNSAVED).write_text(earlier)
    on_full_disks(monkeypatch, run)
    for gone in (False, True):
        if gone:
            shutil.rmtree(run)
        else:
            assert (run / UNSAVED).read_text() == earlier
        _keep_unsaved(run, Plan(tags), ups=False)
        (kept,) = temporary.rglob(UNSAVED)
        assert (Deployment.from_csv(kept).positions == tags.positions).all()
        err = capsys.readouterr().err
        assert f"changes that were not saved are in {kept}\n" in err
        assert str(run) in err
        kept.unlink()


def write_lines(path, lines):
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_folder_with_the_name_of_a_file_is_no_place_to_save(tmp_path):
    (tmp_path / "landmarks.csv").mkdir()

    def write(folder):
        for name in ("a.csv", "landmarks.csv"):
            (folder / name).write_text("new")

    with pytest.raises(IsADirectoryError, match=r"landmarks\.csv"):
        all_or_none(tmp_path, write)
    assert [path.name for path in tmp_path.rglob("*")] == ["landmarks.csv"]
