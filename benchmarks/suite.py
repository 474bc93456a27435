"""Keep the documents of the suite: hashes, bounds, and the best candidates known.

    python benchmarks/suite.py hashes               # write the hash of each document that has none, refuse others
    python benchmarks/suite.py bounds [NAME ...]    # proven bounds, a minute each
    python benchmarks/suite.py collect FOLDER       # records from the runs of a tournament
    python benchmarks/suite.py best [NAME ...] [--optimiser annealing] [--evaluations N] [--seeds 3]

`best` searches with the largest budget of the problem by default, and records a candidate that is better than the one
known. Its value is that of the NumPy reference.
"""

import argparse
import io
import json
import re
import sys
from dataclasses import replace
from functools import reduce
from operator import add
from pathlib import Path

import numpy as np
import pandas as pd
import yaml

import lmd.suite
from lmd.evaluation.bounds import Search, affordable, average_upper_bound, fitness_upper_bound
from lmd.evaluation.relaxation import TimeLimit
from lmd.evaluation.validation import headline_off_grid, validation_metrics
from lmd.formats.rigs import read_mounts, rig_of, write_rig
from lmd.objectives.coverage import MeanCoverage
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.camera_annealing import CameraAnnealing
from lmd.optimisers.greedy import Greedy
from lmd.optimisers.ledger import Budget
from lmd.scene.deployment import Deployment
from lmd.scene.rig import Rig
from lmd.suite.documents import FOLDER, Document
from lmd.suite.frozen import POINT, best_path, camera_of, reference_fitness

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
        front(frozen, box, budget, seed)
        return
    cameras = "cameras" in frozen.problem
    method = optimiser or ("camera_annealing" if cameras else "annealing")
    result = OPTIMISERS[method](seed=seed).run(box.problem, Budget(budget))
    record(frozen, box, result.deployment, result.rig, f"{method}, {budget} evaluations, seed {seed}")


def record(frozen: Document, box: lmd.suite.BlackBox, deployment: Deployment, rig: Rig | None, by: str) -> None:
    """Record a candidate if it is better than the one known."""
    problem = box.problem if rig is None else box.problem.with_rig(rig)
    value = reference_fitness(problem, deployment)
    known = -1.0 if frozen.best is None else frozen.best.value
    print(f"{frozen.name} {by}: {value:.6f}, known {known:.6f}", flush=True)
    if value <= known + LEAST_GAIN:
        return
    off_grid = validation_metrics(problem, deployment, 0)[headline_off_grid(problem)]
    path = best_path(frozen)
    if rig is None:
        deployment.to_csv(path, ups=not problem.scene.tag.is_point)
    else:
        write_rig(path, rig, dict.fromkeys(rig.cameras))
    put(frozen, "best", {"value": value, "off_grid": round(float(off_grid), 6), "by": by})


def collect(folder: Path) -> None:
    """Record the best run of each problem of a tournament."""
    for runs in sorted(path for path in folder.glob("runs/*") if path.is_dir()):
        frozen, box = lmd.suite.document(runs.name), lmd.suite.problem(runs.name, threads=None)
        records = {path.parent: json.loads(path.read_text()) for path in runs.glob("*/run.json")}
        found = max(records, key=lambda folder: records[folder]["metrics"]["fitness"])
        _, evaluations, *entry, seed = records[found]["name"].split()
        by = f"{' '.join(entry)}, {evaluations} evaluations, {seed.replace('=', ' ')}"
        rig = found / "rig.yaml"
        cameras = rig_of(read_mounts(str(rig)), camera_of(frozen)) if rig.exists() else None
        record(frozen, box, Deployment.from_csv(found / "landmarks.csv"), cameras, by)


def front(frozen: Document, box: lmd.suite.BlackBox, budget: int, seed: int) -> None:
    """Search a front by NSGA-II; its value is the hypervolume from the origin."""
    from pymoo.algorithms.moo.nsga2 import NSGA2
    from pymoo.indicators.hv import HV
    from pymoo.optimize import minimize

    starts = np.stack([box.start(each) for each in range(FRONT_POPULATION)])
    method = NSGA2(pop_size=FRONT_POPULATION, sampling=starts)
    found = minimize(lmd.suite.pymoo_problem(box), method, ("n_eval", budget), seed=seed)
    order = np.argsort(found.F[:, 0])
    value = float(HV(ref_point=np.zeros(2))(found.F))
    known = -1.0 if frozen.best is None else frozen.best.value
    print(f"{frozen.name} NSGA-II seed {seed}: {value:.6f}, known {known:.6f}", flush=True)
    if value <= known + LEAST_GAIN:
        return
    rows = [(point, box.deployment(found.X[index])) for point, index in enumerate(order)]
    table = io.StringIO()
    reduce(add, (replace(each, labels=None) for _, each in rows)).to_csv(table)
    table.seek(0)
    points = np.concatenate([np.full(len(each), point) for point, each in rows])
    pd.read_csv(table, dtype=str).drop(columns="id").assign(**{POINT: points}).to_csv(best_path(frozen), index=False)
    put(
        frozen, "best", {"value": value, "off_grid": None, "by": f"NSGA-II of pymoo, {budget} evaluations, seed {seed}"}
    )


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
