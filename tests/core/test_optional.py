"""Packages that only some commands need: what is missing is said at once, with the command that installs it."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from support.composing import composed
from support.processes import call
from support.tables import rows

from lmd.core.checks import InputError
from lmd.core.optional import EXTRAS, missing_of, optional
from pipelines.nodes import instantiate

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# Names of packages that are not those of their modules.
NAMES = {"PIL": "pillow", "cv2": "opencv-python-headless"}


def extras_asked_for():
    """The packages and extras that the code names."""
    code = "\n".join(path.read_text() for folder in ("lmd", "pipelines") for path in (ROOT / folder).rglob("*.py"))
    return {*re.findall(r'optional\("([\w.]+)", "(\w+)"\)', code), *EXTRAS.items()}


def test_every_extra_that_is_named_brings_the_package():
    asked = extras_asked_for()
    assert len(asked) > 10
    for package, extra in asked:
        top = package.split(".")[0]
        brought = [re.match(r"[\w-]+", line)[0] for line in PROJECT["optional-dependencies"][extra]]
        assert NAMES.get(top, top) in brought, (package, extra)


def test_the_library_needs_no_package_of_an_extra():
    core = {re.match(r"[\w-]+", line)[0] for line in PROJECT["dependencies"]}
    assert not core & {NAMES.get(package.split(".")[0], package) for package, _ in extras_asked_for()}


@pytest.fixture
def hidden(monkeypatch):
    """Hides a package as if it were not installed."""
    return lambda name: monkeypatch.setitem(sys.modules, name, None)


def test_a_package_that_is_missing_is_named_with_the_command_that_installs_it(hidden, monkeypatch):
    monkeypatch.chdir(ROOT)
    hidden("trimesh")
    with pytest.raises(InputError) as told:
        optional("trimesh", "mesh")
    assert str(told.value).startswith("this needs the package trimesh: ")
    assert str(told.value).endswith(" -m pip install --constraint constraints.txt --editable '.[mesh]'.")


@pytest.mark.parametrize(("package", "optimiser", "extra"), rows(__file__, "optimisers of libraries"))
def test_an_optimiser_of_a_library_that_is_missing_says_so(hidden, package, optimiser, extra):
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        hidden(name)
    hidden(package)
    node = composed("optimise", f"optimiser={optimiser}").optimiser
    with pytest.raises(InputError, match=rf"^this needs the package {package}: .*\[{extra}\]'\.$"):
        instantiate(node, seed=0)


def test_a_command_without_its_packages_says_so():
    code = "import sys; sys.modules['hydra'] = None; import pipelines.optimise"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("error: this needs the package hydra-core: ")


def test_another_error_is_no_missing_package():
    assert missing_of(ValueError("no")) is None
    assert missing_of(ModuleNotFoundError("no", name="numpyro")) is None


@pytest.mark.slow
@pytest.mark.parametrize(("pipeline", "override", "package", "extra"), rows(__file__, "commands and their packages"))
def test_a_command_that_lacks_a_package_says_so_before_anything_is_computed(
    pipeline, override, package, extra, tmp_path
):
    (tmp_path / "without").mkdir()
    (tmp_path / "without" / f"{package}.py").write_text(f"raise ModuleNotFoundError('hidden', name={package!r})\n")
    settings = (override, "tracking=none", "hydra.run.dir=run")
    done = call(pipeline, *settings, cwd=tmp_path, settings=(), folders=[tmp_path / "without"], fresh=True)
    assert done.returncode == 1
    assert re.fullmatch(rf"error: this needs the package {package}\S*: .*\[{extra}\]'\.\n", done.stderr), done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["without"]
