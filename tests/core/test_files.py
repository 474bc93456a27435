import os

import pytest

from lmd.core.checks import InputError
from lmd.core.files import LARGEST_YAML, read_bytes, read_keys, read_text, write_whole

BOMB = "a0: &a0 [1, 1]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 40))


def refused(read, *given):
    with pytest.raises(InputError) as told:
        read(*given)
    assert str(told.value).isprintable()
    return str(told.value)


def test_what_never_ends_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path, kind in ((tmp_path / "pipe", "a pipe"), ("/dev/zero", "a device"), (tmp_path, "a directory")):
        assert refused(read_bytes, path, "path") == f"path: '{path}' cannot be read: it is {kind}."
    assert refused(read_text, "a\0b", "path").startswith(r"path: 'a\x00b' cannot be read (")


def test_what_is_too_large_is_not_read(tmp_path):
    with (tmp_path / "holes.csv").open("wb") as file:
        file.truncate(1 << 43)  # takes no space
    assert "holes.csv', of 8.796e+12 bytes, would take " in refused(read_text, tmp_path / "holes.csv", "path")
    (tmp_path / "long.yaml").write_bytes(b"#" * (LARGEST_YAML + 1))
    assert refused(read_keys, tmp_path / "long.yaml", "path").endswith("at most 5.243e+05 are allowed.")


def test_aliases_as_they_are_written_by_programs_are_read(write):
    keys = read_keys(write("d: &d [0.1, 1e-5]\ncam0: {lens: *d}\ncam1: {lens: *d}\n"), "path")
    assert keys["cam0"] == keys["cam1"] == {"lens": [0.1, 1e-5]}


def test_what_a_file_is_called_does_not_reach_the_terminal_as_it_is(tmp_path):
    assert refused(read_text, tmp_path / "\x1b]0;owned\a.csv", "path").endswith(r"\x1b]0;owned\x07.csv'.")
    assert str(InputError("a \x1b[2J\n\u202e b")) == r"a \x1b[2J\n\u202e b"
    assert len(str(InputError("x" * 10**6))) < 2000


def test_a_file_is_on_disk_before_it_takes_the_place_of_another(tmp_path, monkeypatch):
    done = []
    monkeypatch.setattr(os, "fsync", lambda _: done.append("fsync"))
    monkeypatch.setattr(os, "replace", lambda *_: done.append("replace"))
    write_whole(tmp_path / "a", b"new")
    assert done == ["fsync", "replace"]


def test_on_a_full_disk_the_former_file_stays(tmp_path, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device")

    (tmp_path / "a").write_text("old")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_whole(tmp_path / "a", b"new")
    assert [path.read_text() for path in tmp_path.iterdir()] == ["old"]
