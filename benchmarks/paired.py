"""Rows of `speed.py` and `rig.py` against another commit, in turn: `python benchmarks/paired.py COMMIT [--rounds N]`.

Each checkout measures its own rows in a process of its own; the two take turns. A row that is more than 3 % slower is
measured again by new processes, up to five times in all: where a process happens to have its arrays decides up to a
tenth of a row. The least times of both count. Prints a Markdown table of them and their ratio,
and exits with 1 if a row stays slower.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from same_results import HERE, checkout
from speed import best_of

ALLOWED = 1.03
CALLS = 9
AGAIN = 5
Rows = dict[str, Callable[[], float]]


def speed_rows() -> Rows:
    """One thread, the paper's problem, and the largest of the problems of `speed.scaling`."""
    import speed
    from speed import COUNT, DEPLOYMENTS, STEPS

    scene = speed.paper_scene()
    rows: Rows = {
        "evaluation of a batch": lambda: speed.evaluation(scene, COUNT, 1, DEPLOYMENTS),
        "evaluation by itself": lambda: speed.evaluation(scene, COUNT, 1, 1),
        "gains of poses": lambda: speed.all_gains(scene, 1)[1],
    }
    for step in STEPS:
        rows[f"one moved, {step}"] = lambda step=step: speed.moves(scene, COUNT, step)  # type: ignore[misc]
    for count in (45, 500):
        rows[f"{count} landmarks, evaluation"] = lambda count=count: speed.evaluation(scene, count, 1)  # type: ignore[misc]
        rows[f"{count} landmarks, one moved"] = lambda count=count: speed.moves(scene, count, STEPS[-1])  # type: ignore[misc]
    return rows


def rig_rows() -> Rows:
    """The rows of `rig.py` by default."""
    import rig

    from lmd.scene import pdf

    rows: Rows = {}
    for goal in list(rig.OBJECTIVES)[:2]:
        for drawn, orientations in {"yaw, 72": pdf.level_flight(36), "grid_325": pdf.grid_with_ends()}.items():
            for label, camera in rig.cameras().items():
                for task, work in rig.tasks(camera, orientations, goal).items():
                    rows[f"{goal}, {drawn}, {label}, {task}"] = lambda work=work: taken(work)  # type: ignore[misc]
    return rows


def taken(work: Callable[[], object]) -> float:
    """Processor seconds of one call, the least of some."""
    return best_of(CALLS, work, time.process_time)


def serve(script: str) -> None:
    """Measure the rows that are asked for, by their number."""
    import lmd
    import pipelines

    code = Path(os.environ["PYTHONPATH"].partition(os.pathsep)[0])
    assert Path(lmd.__file__).parents[1] == Path(pipelines.__file__).parents[1] == code, lmd.__file__
    rows = speed_rows() if script == "speed" else rig_rows()
    print("\n".join(rows), end="\n\n", flush=True)
    for line in sys.stdin:
        print(list(rows.values())[int(line)](), flush=True)


class Checkout:
    """A process that measures rows of a checkout."""

    def __init__(self, code: Path, cache: Path, script: str) -> None:
        folders = os.pathsep.join(map(str, (code, code / "benchmarks")))
        environment = os.environ | {"PYTHONPATH": folders, "NUMBA_CACHE_DIR": str(cache / code.name)}
        # This file is run by its path, from a folder without modules: all that it imports is the checkout's own.
        # An editable installation finds `lmd.pipelines` in its own checkout, whatever PYTHONPATH has.
        arguments, path = ["", "--serve", script], str(Path(__file__).resolve())
        run = (
            "import sys, runpy, pipelines; sys.modules['lmd.pipelines'] = pipelines; "
            f"sys.argv = {arguments}; runpy.run_path({path!r}, run_name='__main__')"
        )
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            [sys.executable, "-c", run], cwd=cache, env=environment, stdin=pipe, stdout=pipe, text=True
        )
        assert self._process.stdin, "it has pipes"
        assert self._process.stdout, "it has pipes"
        self._asked, self._told = self._process.stdin, self._process.stdout
        self.labels = list(iter(lambda: self._told.readline().strip(), ""))

    def measure(self, number: int) -> float:
        """Seconds of a row."""
        print(number, file=self._asked, flush=True)
        return float(self._told.readline())

    def close(self) -> None:
        """End the process."""
        self._asked.close()
        self._process.wait()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commit", nargs="?")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", choices=("speed", "rig"))
    parser.add_argument("--row", default="", help="of the rows those whose label has this")
    parser.add_argument("--serve", choices=("speed", "rig"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        serve(options.serve)
        return
    slower = 0
    print("| row | before, ms | now, ms | now / before |\n| --- | --- | --- | --- |")
    with checkout(options.commit) as before, tempfile.TemporaryDirectory() as caches:
        for script in (options.only,) if options.only else ("speed", "rig"):
            both = [Checkout(code, Path(caches), script) for code in (before, HERE)]
            assert both[0].labels == both[1].labels, "the two commits have the same rows"
            for number, label in enumerate(both[1].labels):
                if options.row not in label:
                    continue
                was = now = np.inf
                for again in range(AGAIN):
                    if again:
                        for each in both:
                            each.close()
                        both = [Checkout(code, Path(caches), script) for code in (before, HERE)]
                    for each in both:
                        each.measure(number)  # compiles
                    rounds = [[each.measure(number) for each in both] for _ in range(options.rounds)]
                    was, now = (
                        min(1e3 * min(new), old) for new, old in zip(zip(*rounds, strict=True), (was, now), strict=True)
                    )
                    if now <= ALLOWED * was:
                        break
                slower += now > ALLOWED * was
                print(f"| {label} | {was:.4g} | {now:.4g} | {now / was:.3f} |", flush=True)
            for each in both:
                each.close()
    sys.exit(slower > 0)


if __name__ == "__main__":
    main()
