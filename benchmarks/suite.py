"""Keep the documents of the suite: hashes, bounds, and the best candidates known.

    python benchmarks/suite.py hashes               # write the hash of each document that has none, refuse others
    python benchmarks/suite.py bounds [NAME ...]    # proven bounds, a minute each
    python benchmarks/suite.py collect FOLDER       # records from the runs of a tournament
    python benchmarks/suite.py best [NAME ...] [--optimiser annealing] [--evaluations N] [--seeds 3]

`best` searches with the largest budget of the problem by default, and records a candidate that is better than the one
known. Its value is that of the NumPy reference.
"""

import argparse
import datetime
import io
import re
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial, reduce
from operator import add
from pathlib import Path

import numpy as np
import pandas as pd
import yaml

import lmd.suite
from lmd.evaluation.bounds import Search, affordable, average_upper_bound, fitness_upper_bound
from lmd.evaluation.relaxation import TimeLimit
from lmd.formats.rigs import write_rig
from lmd.objectives.coverage import MeanCoverage
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.camera_annealing import CameraAnnealing
from lmd.optimisers.greedy import Greedy
from lmd.optimisers.ledger import Budget
from lmd.suite.documents import BEST, FOLDER, Document
from lmd.suite.records import POINT

OPTIMISERS = {"annealing": Annealing, "camera_annealing": CameraAnnealing, "greedy": Greedy}
BOUND_SECONDS = 90.0
FRONT_POPULATION = 60
LEAST_GAIN = 1e-9  # of a value over the one known


def hashes() -> int:
    """Write missing hashes; returns the number of problems whose hash has changed."""
    changed = 0
    for name in lmd.suite.names():
        frozen = lmd.suite.document(name)
        if frozen.hash in ("0", 0):
            put(frozen, "hash", frozen.digest)
        elif frozen.hash != frozen.digest:
            print(f"{name}: hash {frozen.digest}, not {frozen.hash}: give it a new version, or take the change back")
            changed += 1
    return changed


def bounds(names: list[str]) -> None:
    """Write proven bounds that are below 1."""
    for name in names:
        frozen, box = lmd.suite.document(name), lmd.suite.problem(name, threads=None)
        if len(box.objectives) > 1 or "cameras" in frozen.problem:
            continue
        problem = box.problem
        search = affordable(problem, problem.count, Search(limit=TimeLimit(BOUND_SECONDS)))
        of = average_upper_bound if isinstance(problem.objective, MeanCoverage) else fitness_upper_bound
        found = of(problem, problem.count, search).walls
        print(f"{name}: {found:.6f}", flush=True)
        if found < 1.0 and (frozen.bound is None or found < frozen.bound):
            put(frozen, "bound", float(np.ceil(found * 1e6) / 1e6))


def best(name: str, optimiser: str | None, evaluations: int | None, seed: int) -> None:
    """Search once, and record what is better than the candidate known."""
    frozen, box = lmd.suite.document(name), lmd.suite.problem(name, threads=None)
    budget = evaluations or frozen.budgets[-1]
    if len(box.objectives) > 1:
        table, by = front(box, budget, seed)
        enter(frozen, by, lambda folder: table.to_csv(folder / f"{name}.csv", index=False))
        return
    method = optimiser or ("camera_annealing" if "cameras" in frozen.problem else "annealing")
    result = OPTIMISERS[method](seed=seed).run(box.problem, Budget(budget))

    def write(folder: Path) -> None:
        if result.rig is None:
            result.deployment.to_csv(folder / f"{name}.csv", ups=not box.problem.scene.tag.is_point)
        else:
            write_rig(folder / f"{name}.rig.yaml", result.rig, dict.fromkeys(result.rig.cameras))

    enter(frozen, f"{method}, {budget} evaluations, seed {seed}", write)


def enter(frozen: Document, how: str, write: Callable[[Path], object], who: str = "lmd") -> None:
    """Record a candidate, which `write` writes to a folder, if it is better than the one known."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        write(folder)
        (candidate,) = folder.iterdir()
        entry = {"problem": frozen.name, "who": who, "how": how, "when": f"{datetime.date.today()}"}
        (folder / "entry.yaml").write_text(yaml.safe_dump(entry | {"candidate": candidate.name}))
        record = lmd.suite.verify(folder / "entry.yaml")
        known = -1.0 if frozen.best is None else frozen.best["value"]
        print(f"{frozen.name} {how}: {record['value']:.6f}, known {known:.6f}", flush=True)
        if record["value"] > known + LEAST_GAIN:
            shutil.copy(candidate, BEST)
            (BEST / f"{frozen.name}.yaml").write_text(yaml.safe_dump(record, sort_keys=False))
            lmd.suite.document.cache_clear()


def collect(folder: Path) -> None:
    """Record the best run of each problem of a tournament."""
    for runs in sorted(path for path in folder.glob("runs/*") if path.name in lmd.suite.names()):
        reached = {path.parent: pd.read_csv(path).best_fitness.iloc[-1] for path in runs.glob("*/history.csv")}
        found = max(reached, key=reached.__getitem__)
        _, evaluations, *entry, seed = found.name.split()
        how = f"{' '.join(entry)}, {evaluations} evaluations, {seed.replace('=', ' ')}"
        source, kind = (
            (found / "rig.yaml", "rig.yaml") if (found / "rig.yaml").exists() else (found / "landmarks.csv", "csv")
        )
        enter(lmd.suite.document(runs.name), how, partial(_copy, source, f"{runs.name}.{kind}"))


def _copy(source: Path, name: str, folder: Path) -> None:
    shutil.copy(source, folder / name)


def front(box: lmd.suite.BlackBox, budget: int, seed: int) -> tuple[pd.DataFrame, str]:
    """Search a front by NSGA-II: its landmarks with the number of the point, and how it was found."""
    from pymoo.algorithms.moo.nsga2 import NSGA2
    from pymoo.optimize import minimize

    starts = np.stack([box.start(each) for each in range(FRONT_POPULATION)])
    method = NSGA2(pop_size=FRONT_POPULATION, sampling=starts)
    found = minimize(lmd.suite.pymoo_problem(box), method, ("n_eval", budget), seed=seed)
    rows = [(point, box.deployment(found.X[index])) for point, index in enumerate(np.argsort(found.F[:, 0]))]
    table = io.StringIO()
    reduce(add, (replace(each, labels=None) for _, each in rows)).to_csv(table)
    table.seek(0)
    points = np.concatenate([np.full(len(each), point) for point, each in rows])
    landmarks = pd.read_csv(table, dtype=str).drop(columns="id").assign(**{POINT: points})
    return landmarks, f"NSGA-II of pymoo, {budget} evaluations, seed {seed}"


def put(frozen: Document, key: str, value: object) -> None:
    """Replace a value of a document, whose other lines stay."""
    path = FOLDER / f"{frozen.name}.yaml"
    text = yaml.safe_dump([value], sort_keys=False, width=1000, default_flow_style=True).strip()[1:-1]
    line = re.compile(rf"^{key}:.*$", re.MULTILINE)
    path.write_text(line.sub(lambda _: f"{key}: {text}", path.read_text(), count=1))
    lmd.suite.document.cache_clear()


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("hashes", "bounds", "best", "collect"))
    parser.add_argument("names", nargs="*")
    parser.add_argument("--optimiser", choices=[*OPTIMISERS])
    parser.add_argument("--evaluations", type=int)
    parser.add_argument("--seeds", type=int, default=3)
    given = parser.parse_args()
    if given.what == "collect":
        collect(Path(given.names[0]))
        return 0
    names = given.names or lmd.suite.names()
    if given.what == "hashes":
        return hashes()
    if given.what == "bounds":
        bounds(names)
        return 0
    for name in names:
        for seed in range(given.seeds):
            best(name, given.optimiser, given.evaluations, seed)
    return 0


if __name__ == "__main__":
    sys.exit(main())
