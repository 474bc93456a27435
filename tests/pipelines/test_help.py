"""Packages that commands import: each unneeded one would take a tenth of a second or more."""

import json
import re
import subprocess
import sys

import pytest
from processes import environment

pytestmark = pytest.mark.slow
MODEL = ("numba", "mlflow", "matplotlib", "pandas")
SLOW = {
    "optimise": MODEL,
    "evaluate": MODEL,
    "observe": (*MODEL, "cv2", "gtsam"),
    "detect": (*MODEL, "cv2", "numpy"),
    "export": ("mlflow", "scipy", "cv2", "reportlab"),
    "view": ("mlflow", "scipy", "viser", "matplotlib"),
}
LISTED = {
    "optimise": ("deployment: file, greedy, random, uniform",),
    "evaluate": ("deployment: file, greedy, random, uniform",),
    "observe": (
        "estimator: bound, eqf, iekf, iekf_bias, left_observer, observer, pnp",
        "trajectory: file, random_drives, random_motion, waypoints",
    ),
    "detect": ("detectors: apriltag, apriltag_decimate2, aruco, aruco_fine",),
    "export": (),
    "view": (),
}
RUN = ("room.spacing=1.5", "tracking=none", "validate=true", "picture=true")
RUNS = (
    ("optimise", "budget.evaluations=1", *RUN, "hydra.run.dir=optimised"),
    ("evaluate", "deployment=random", "localisation=false", *RUN, "hydra.run.dir=evaluated"),
)
OTHERS = ("scipy.optimize", "scipy.spatial", "scipy.sparse", "scipy.stats", "pymoo", "nevergrad", "cv2")
CASES = {
    **{pipeline: ([[pipeline, "--help"]], slow) for pipeline, slow in SLOW.items()},
    "runs": (RUNS, ("pandas", "mlflow", *OTHERS)),
}
# Each is forked from a process that has imported what all commands import first, which is most of what `--help` takes.
CODE = """
import contextlib, importlib, io, json, os, sys
import pipelines.pipeline
for case, (commands, slow) in json.load(sys.stdin).items():
    if os.fork():
        assert os.wait()[1] == 0, case
        continue
    told = io.StringIO()
    with contextlib.redirect_stdout(told):
        for pipeline, *arguments in commands:
            sys.argv = [pipeline, *arguments]
            with contextlib.suppress(SystemExit):
                importlib.import_module(f"pipelines.{pipeline}").main()
    print(json.dumps([case, told.getvalue(), [name for name in slow if name in sys.modules]]), flush=True)
    os._exit(0)
"""


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    return tmp_path_factory.mktemp("work")


@pytest.fixture(scope="module")
def told(work):
    """Output of each case, and the packages that it has loaded."""
    line, options = [sys.executable, "-c", CODE], {"capture_output": True, "text": True, "check": False}
    done = subprocess.run(line, cwd=work, env=environment(), input=json.dumps(CASES), **options)
    assert done.returncode == 0, done.stderr
    return {case: (text, loaded) for case, text, loaded in map(json.loads, done.stdout.splitlines())}


@pytest.mark.parametrize("pipeline", SLOW)
def test_help_lists_the_groups_without_loading_the_model(pipeline, told):
    text, loaded = told[pipeline]
    assert loaded == []
    groups = [line.partition(":")[0] for line in text.splitlines() if re.match(r"\w+: ", line)]
    assert len(groups) == len(set(groups)) > 5
    assert all(line in text for line in LISTED[pipeline])
    assert ("trajectory" in groups) == (pipeline == "observe")


def test_a_run_loads_nothing_that_only_others_need(told, work):
    text, loaded = told["runs"]
    assert text.count("off the grid") == 2
    assert loaded == []
    for folder in ("optimised", "evaluated"):
        assert (work / folder / "scene.png").stat().st_size > 0
