"""The package as it is installed: everything below lmd, and complete."""

import os
import re
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from pathlib import Path
from shutil import copytree, ignore_patterns

import pytest

import lmd

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
INSTALLED = pytest.mark.thorough("pyproject.toml", "pipelines/app.py", "pipelines/composing.py")
SMALL = ["room.spacing=1.5", "objective.thold_p=0.5", "validate=false", "budget.evaluations=60"]


def test_every_folder_of_code_is_in_the_list_of_packages():
    def packages(folder, name):
        below = sorted({path.parent.relative_to(ROOT / folder) for path in (ROOT / folder).rglob("*.py")})
        return {".".join([name, *path.parts]) for path in below}

    listed = PROJECT["tool"]["setuptools"]["packages"]
    assert len(listed) == len(set(listed))
    assert set(listed) == packages("lmd", "lmd") | packages("pipelines", "lmd.pipelines") | {"lmd.conf"}


COMMANDS = {
    path.stem
    for path in (ROOT / "pipelines").glob("*.py")
    if 'if __name__ == "__main__":' in path.read_text(encoding="utf-8")
}
PAGES = {path.relative_to(ROOT / "docs").as_posix(): path.read_text(encoding="utf-8")
         for path in (ROOT / "docs").rglob("*.md")}  # fmt: skip


def test_every_command_has_a_console_script():
    scripts = {f"lmd-{name.replace('_', '-')}": f"lmd.pipelines.{name}:main" for name in COMMANDS}
    assert PROJECT["project"]["scripts"] == scripts


def test_every_command_with_a_configuration_is_in_the_table_of_commands_and_on_a_page():
    assert not [name for name in COMMANDS if not (ROOT / "conf" / f"{name}.yaml").exists()]
    cells = re.findall(r"^\| (`[^|]*) \|", PAGES["running.md"].split("## ")[0], re.MULTILINE)
    assert {name for cell in cells for name in re.findall(r"`(\w+)`", cell)} == COMMANDS
    pages = "".join(PAGES.values())
    assert not [name for name in COMMANDS if f"pipelines.{name}" not in pages]


def test_every_page_is_in_the_navigation():
    navigation = re.findall(r"([\w/]+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(navigation) == sorted(PAGES)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """A wheel, built from a copy so that the tree stays clean."""
    source, built = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for folder in ("lmd", "pipelines", "conf"):
        copytree(ROOT / folder, source / folder, ignore=ignore_patterns("__pycache__"))
    for file in ("pyproject.toml", "README.md", "LICENSE"):
        (source / file).write_bytes((ROOT / file).read_bytes())
    pip(sys.executable, "wheel", "--no-deps", "--wheel-dir", built, source)
    (path,) = built.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def commands(wheel, tmp_path_factory):
    """The folder of the console scripts of an environment with the wheel and, by a path, what the tests run with."""
    fresh = tmp_path_factory.mktemp("fresh")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", fresh], check=True)
    (site,) = fresh.glob("lib/python*/site-packages")
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib"))
    pip(fresh / "bin" / "python", "install", "--no-deps", wheel)
    return fresh / "bin"


def pip(python, *arguments):
    line = [sys.executable, "-m", "pip", "--python", python, "--disable-pip-version-check", *arguments]
    subprocess.run(line, check=True)


def call(script, *overrides, cwd):
    """Run a console script without the checkout in sight."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    line = [script, *overrides, *SMALL]
    done = subprocess.run(line, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def work(tmp_path):
    """An otherwise empty working directory with an optimiser of one's own."""
    (tmp_path / "optimiser").mkdir()
    (tmp_path / "optimiser" / "mine.yaml").write_text(
        "_target_: lmd.optimisers.genetic.RandomSearch\nbatch: 10\nencoding: wall\n"
    )
    return tmp_path


@pytest.mark.slow
def test_nothing_but_lmd_is_installed_and_nothing_is_missing(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    version = lmd.__version__
    assert {name.split("/")[0] for name in names} == {"lmd", f"lmd-{version}.dist-info"}
    for folder in ("lmd", "pipelines", "conf"):
        below = "" if folder == "lmd" else "lmd/"
        here = [path for path in (ROOT / folder).rglob("*") if path.suffix in (".py", ".yaml", ".typed")]
        assert {f"{below}{path.relative_to(ROOT)}" for path in here} <= names


@pytest.mark.slow
@INSTALLED
def test_an_installed_command_works_in_an_empty_folder(commands, tmp_path):
    out = call(commands / "lmd-optimise", "optimiser=random_search", cwd=tmp_path)
    assert "(mlflow ui --backend-store-uri sqlite:///outputs/mlflow.db)" in out
    assert [path.name for path in tmp_path.iterdir()] == ["outputs"]
    assert list(tmp_path.glob("outputs/optimise/*/landmarks.csv"))


@pytest.mark.slow
@INSTALLED
def test_an_installed_sweep_takes_an_optimiser_from_a_folder_of_ones_own(commands, work):
    out = call(commands / "lmd-optimise", "-m", "--config-dir", ".", "optimiser=mine", "seed=1,2", "tracking=none",
               cwd=work)  # fmt: skip
    assert "2 of 2 jobs finished" in out
