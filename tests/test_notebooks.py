"""The notebooks run from top to bottom, and are kept with what they show."""

import os
from pathlib import Path

import nbformat
import pytest
from jupyter_client import KernelManager
from nbclient import NotebookClient

ROOT = Path(__file__).parents[1]
MOST_BYTES = 300_000  # of a notebook with its pictures
SHOWN, TESTED = "evaluations=400", "evaluations=90"  # of a search
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


def test_there_are_notebooks():
    assert [path.stem[:2] for path in NOTEBOOKS] == ["01", "02", "03", "04", "05", "06"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_kept_with_its_pictures(path):
    cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    outputs = [output for cell in cells for output in cell.outputs]
    assert all(cell.execution_count for cell in cells), "run `make notebooks`"
    assert not [output for output in outputs if output.output_type == "error" or output.get("name") == "stderr"]
    assert [output for output in outputs if "image/png" in output.get("data", {})]
    assert path.stat().st_size < MOST_BYTES


@pytest.fixture(scope="module")
def kernel(tmp_path_factory):
    """A kernel in an empty folder, shared by all notebooks: imports take most of the time of each."""
    manager, folders = KernelManager(kernel_name="python3"), [tmp_path_factory.mktemp(name) for name in ("work", "tmp")]
    work, temporary = folders
    manager.start_kernel(cwd=work, env=os.environ | {"PYTHONPATH": str(ROOT), "TMPDIR": str(temporary)})
    yield manager, work
    manager.shutdown_kernel(now=True)


@pytest.mark.slow
@pytest.mark.thorough("lmd/__init__.py", "lmd/plot", "lmd/run.py", "lmd/suite", "notebooks", "pipelines/operations")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_leaves_nothing_behind(path, kernel):
    manager, work = kernel
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        cell.source = cell.source.replace(SHOWN, TESTED)
    notebook.cells.insert(0, nbformat.v4.new_code_cell("%reset -f"))  # nothing that another has made
    NotebookClient(notebook, timeout=300, km=manager).execute()
    assert not list(work.iterdir())
    pictures = [o for c in notebook.cells for o in c.get("outputs", []) if "image/png" in o.get("data", {})]
    assert pictures
