"""The sources of a run: packages, and the changes of a checkout that no commit has."""

import re
import subprocess

import pytest

from pipelines import provenance


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A checkout with one commit; its provenance is not remembered."""
    work = tmp_path / "checkout"
    (work / "conf").mkdir(parents=True)
    (work / "conf" / "a.yaml").write_text("a: 1\n")
    for line in ("init -q", "add .", "-c user.name=a -c user.email=a@b commit -qm first"):
        subprocess.run(["git", *line.split()], cwd=work, check=True)
    monkeypatch.setattr(provenance, "CONF", str(work / "conf"))
    for function in (provenance._version, provenance._patch):
        monkeypatch.setattr(provenance, function.__name__, function.__wrapped__)
    return work


def test_a_changed_checkout_leaves_a_patch_that_repeats_it(checkout, tmp_path):
    provenance.write_sources(tmp_path / "clean")
    assert [path.name for path in (tmp_path / "clean").iterdir()] == ["packages.txt"]
    (checkout / "conf" / "a.yaml").write_text("a: 2\n")
    (checkout / "new.py").touch()
    provenance.write_sources(tmp_path / "dirty")
    patch = tmp_path / "dirty" / "diff.patch"
    assert patch.read_text().startswith("# untracked: new.py\ndiff --git a/conf/a.yaml b/conf/a.yaml\n")
    subprocess.run(["git", "checkout", "-q", "."], cwd=checkout, check=True)
    subprocess.run(["git", "apply", patch], cwd=checkout, check=True)
    assert (checkout / "conf" / "a.yaml").read_text() == "a: 2\n"
    told = provenance.repeating({"command": "lmd", **provenance._version()})
    assert provenance.repeating({"command": "lmd `a*`"}) == "<code>lmd &#96;a&#42;&#96;</code>"
    assert re.fullmatch(r"`lmd`\n\nat commit [0-9a-f]{9}, with the changes in diff.patch", told)


def test_a_full_disk_ends_no_run(tmp_path, capsys):
    (tmp_path / "file").touch()
    provenance.write_sources(tmp_path / "file" / ".hydra")
    assert f"warning: {tmp_path}/file/.hydra has no packages.txt (" in capsys.readouterr().err
