"""Speed of the exact paths: `python benchmarks/speed.py [--update docs/results/performance.md] [--against COMMIT]`.

Prints Markdown tables of times and ratios, all measured in one run on the paper's problem (756 positions, 325
orientations, 90 landmarks, the paper's occlusion test) and on larger ones. With `--update`, the part of the page
between the two marks is replaced by the output, and the plot of the scaling is written beside it. With `--against`, it
prints instead what runs of the paper's problem take, in turn with those of that commit: its processor seconds on one
thread, less those of one evaluation.
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from hydra import compose, initialize_config_dir
from numba import njit
from same_results import HERE, checkout
from start import processor_seconds

from lmd.core.threads import available_threads
from lmd.incremental.coverage_field import coverage_field
from lmd.incremental.trial import bound_move, carry_out, finish_move
from lmd.pipelines.app import CONF
from lmd.pipelines.building import build_problem
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.pdf import grid_with_ends
from lmd.scene.scene import Scene
from lmd.sight import reference
from lmd.sight.evaluator import Evaluator
from lmd.sight.poses import candidate_poses, gains

COUNT, N = 90, 2  # of the paper: landmarks, and how many must be seen
DEPLOYMENTS = 20
MOVES = 2000
STEPS = ("bounded", "tried", "carried out")
EVALUATIONS = 2000  # of a run that is compared with another commit's
ROUNDS = 3
MARKS = ("<!-- benchmark -->", "<!-- end of benchmark -->")


def best_of(repeats: int, work: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    """Seconds of the fastest of several runs, after one that may compile."""
    work()
    times = []
    for _ in range(repeats):
        began = clock()
        work()
        times.append(clock() - began)
    return min(times)


def paper_scene() -> Scene:
    """The paper's simulation."""
    with initialize_config_dir(CONF, version_base="1.3"):
        return build_problem(compose("optimise")).scene


@njit(nogil=True)
def move_all(poses, surfaces, field, state, scratch, steps):  # type: ignore[no-untyped-def]
    """Move the landmarks in turn to each of the poses `(M, 6)`, as an optimiser does: the first of `STEPS`."""
    for i in range(len(poses)):
        k = i % state.poses.shape[1]
        bound_move(field, k, poses[i], surfaces[i], state, scratch)
        if steps > 1:
            finish_move(field, k, state, scratch)
        if steps > 2:
            carry_out(field, k, state, scratch)


def evaluation(scene: Scene, count: int, threads: int, batch: int = DEPLOYMENTS) -> float:
    """Seconds of one evaluation, in a batch of random deployments."""
    rng = np.random.default_rng(0)
    drawn = [RandomDeployment(count).draw(scene.room, rng) for _ in range(batch)]
    positions, normals = np.stack([d.positions for d in drawn]), np.stack([d.normals for d in drawn])
    evaluator = Evaluator(scene, threads=threads)
    return best_of(5 * DEPLOYMENTS // batch, lambda: evaluator.units(positions, normals, N)) / batch


def moves(scene: Scene, count: int, step: str) -> float:
    """Seconds of moving one landmark to a random place, up to one of `STEPS`."""
    rng = np.random.default_rng(0)
    start, targets = (RandomDeployment(size).draw(scene.room, rng) for size in (count, MOVES))
    field = coverage_field(Evaluator(scene, threads=1), N)
    state = field.state(start)
    poses = np.hstack([targets.positions, targets.normals])
    args = (poses, targets.surfaces, field, state, field.scratch(state), 1 + STEPS.index(step))
    return best_of(5, lambda: move_all(*args)) / MOVES


def all_gains(scene: Scene, threads: int) -> tuple[int, float]:
    """Number of poses of a grid of 25 cm, and the seconds to compute the gain of each."""
    poses, evaluator = candidate_poses(scene.room, 0.25), Evaluator(scene, threads=threads)
    prices = np.ones((len(evaluator.positions), evaluator.axes.shape[1]))
    return len(poses), best_of(5, lambda: gains(evaluator, poses, prices))


def whole_pipeline() -> float:
    """Seconds of the paper's EGA with its 12,000 evaluations from the command line, tracking and pictures included."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pipelines.optimise", "optimiser=ega", f"hydra.run.dir={folder}/run"]
        command.append(f"tracking.uri=sqlite:///{folder}/mlflow.db")
        began = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)
        return time.perf_counter() - began


def speed(scene: Scene) -> Iterator[str]:
    """The main table: what one piece of work takes, against the reference."""
    drawn = RandomDeployment(COUNT).draw(scene.room, np.random.default_rng(0))
    base = best_of(3, lambda: reference.counts(scene, drawn))
    rows = [("reference, one evaluation", base)]
    for kind, batch in (("of a batch", DEPLOYMENTS), ("by itself", 1)):
        for threads in sorted({1, available_threads()}):
            label = f"one evaluation {kind}, {threads} thread{'s' * (threads > 1)}"
            rows.append((label, evaluation(scene, COUNT, threads, batch)))
    rows += [(f"one landmark moved, {step}", moves(scene, COUNT, step)) for step in STEPS]
    for threads in sorted({1, available_threads()}):
        poses, seconds = all_gains(scene, threads)
        rows.append((f"gain of each of {poses} poses, {threads} thread{'s' * (threads > 1)}", seconds))
    yield "| work | milliseconds | reference / this |\n| --- | --- | --- |"
    for name, seconds in rows:
        yield f"| {name} | {1e3 * seconds:.3f} | {base / seconds:.1f} |"
    yield f"\n`optimiser=ega`, 12,000 evaluations, the whole command: {whole_pipeline():.1f} s."


def scaling(scene: Scene, picture: Path | None) -> Iterator[str]:
    """Cost of the smallest and the largest problem; the picture has the others."""
    fine_room = [replace(scene.room, spacing=spacing) for spacing in (1.0, 0.5, 0.25)]
    fine_pdf = [grid_with_ends(divisions) for divisions in (6, 12, 24)]
    sweeps = {
        "positions": [(replace(scene, room=room), COUNT) for room in fine_room],
        "orientations": [(replace(scene, pdf=pdf), COUNT) for pdf in fine_pdf],
        "landmarks": [(scene, count) for count in (45, COUNT, 180, 500)],
        "all": [(scene, COUNT), (replace(scene, room=fine_room[-1], pdf=fine_pdf[-1]), 500)],
    }
    yield "| positions | orientations | landmarks | evaluation, ms | one moved, ms |\n| --- | --- | --- | --- | --- |"
    points: dict[str, list[tuple[int, float, float]]] = {}
    for name, cases in sweeps.items():
        for case, count in cases:
            sizes = len(case.room.grid()), len(case.pdf.weight), count
            seconds, moved = evaluation(case, count, 1), moves(case, count, "carried out")
            if name == "all":
                yield f"| {' | '.join(f'{size:,}' for size in sizes)} | {1e3 * seconds:.3f} | {1e3 * moved:.3f} |"
            else:
                points.setdefault(name, []).append((sizes[list(sweeps).index(name)], 1e3 * seconds, 1e3 * moved))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    yield f"\nPeak memory of the benchmark, all libraries and the largest case included: {peak:.2f} GiB."
    if picture:
        plot(points, picture)


def plot(points: dict[str, list[tuple[int, float, float]]], picture: Path) -> None:
    """Cost against each dimension, with a line of slope 1."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.ticker import FixedLocator, NullLocator

    figure, panels = plt.subplots(1, len(points), figsize=(10, 3.2), sharey=True, layout="constrained")
    for panel, (name, rows) in zip(panels, points.items(), strict=True):
        size, evaluated, moved = np.array(rows).T
        panel.loglog(size, evaluated, "o-", label="full evaluation")
        panel.loglog(size, moved, "s-", label="one landmark moved")
        panel.loglog(size, evaluated[1] * size / size[1], ":", color="grey", label="proportional")
        panel.set_xlabel(name)
        panel.xaxis.set_major_locator(FixedLocator(size))
        panel.xaxis.set_major_formatter("{x:,.0f}")
        panel.xaxis.set_minor_locator(NullLocator())
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("milliseconds, one thread")
    panels[0].legend()
    figure.savefig(picture, dpi=110)
    plt.close(figure)


def against(commit: str) -> Iterator[str]:
    """A table of runs by this checkout and by a commit of it, in turn; the first round only compiles."""
    settings = ("threads=1", "tracking=none", "validate=false")
    yield "| optimiser | before, s | now, s | ratios | median |\n| --- | --- | --- | --- | --- |"
    with checkout(commit) as before, tempfile.TemporaryDirectory() as caches:

        def taken(code: Path, optimiser: str, evaluations: int) -> float:
            overrides = (f"optimiser={optimiser}", f"budget.evaluations={evaluations}", *settings)
            return processor_seconds(code, Path(caches) / code.name, "optimise", *overrides)

        for optimiser in ("ega", "annealing"):
            times = [
                [taken(code, optimiser, EVALUATIONS) - taken(code, optimiser, 1) for code in (before, HERE)]
                for _ in range(1 + ROUNDS)
            ]
            then, now = np.array(times[1:]).T
            texts = [", ".join(f"{value:.2f}" for value in values) for values in (then, now, now / then)]
            yield f"| {optimiser} | {' | '.join(texts)} | {np.median(now / then):.2f} |"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Measure the exact paths; prints Markdown.")
    parser.add_argument("--update", type=Path, metavar="PAGE", help="write the output between the marks of this page")
    parser.add_argument("--against", metavar="COMMIT", help="compare runs with those of a commit, and nothing else")
    options = parser.parse_args()
    if options.against:
        for line in against(options.against):
            print(line, flush=True)
        return
    page = options.update
    scene, lines = paper_scene(), []
    sections = {
        "## Speed": speed(scene),
        "## Scaling": scaling(scene, page.parent / "images" / "scaling.png" if page else None),
    }
    for title, section in sections.items():
        for line in (title, "", *section, ""):
            print(line, flush=True)
            lines.append(line)
    if page:
        before, rest = page.read_text().split(MARKS[0])
        after = rest.split(MARKS[1])[1]
        page.write_text("\n".join([before + MARKS[0], "", *lines, ""])[:-1] + MARKS[1] + after)


if __name__ == "__main__":
    main()
