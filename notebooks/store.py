"""Run the notebooks and keep what they show: `make notebooks`, or `python notebooks/store.py FILE ...` for some."""

import base64
import io
import os
import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from PIL import Image

FOLDER = Path(__file__).resolve().parent
PNG = "image/png"
COLOURS = 48  # of a picture that is kept: a quarter of the bytes, and the eye hardly sees it


def stored(path: Path) -> None:
    """Run a notebook in an empty folder and write it with its outputs, but without what goes to stderr."""
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as work:
        options = {"timeout": 600, "kernel_name": "python3", "record_timing": False}
        NotebookClient(notebook, **options, resources={"metadata": {"path": work}}).execute()
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]
            for output in cell.outputs:
                if PNG in output.get("data", {}):
                    output["data"][PNG] = smaller(output["data"][PNG])
    notebook.metadata = {"kernelspec": notebook.metadata["kernelspec"]}
    nbformat.write(notebook, path)
    print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB", flush=True)


def smaller(png: str) -> str:
    """A picture in base64 with fewer colours."""
    out = io.BytesIO()
    picture = Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB")
    picture.quantize(COLOURS).save(out, "PNG", optimize=True)
    return base64.b64encode(out.getvalue()).decode()


if __name__ == "__main__":
    os.environ["PYTHONPATH"] = str(FOLDER.parent)
    for name in sys.argv[1:] or sorted(map(str, FOLDER.glob("*.ipynb"))):
        stored(Path(name))
