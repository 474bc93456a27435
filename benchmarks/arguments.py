"""Count the LLVM arguments that a move passes: `python benchmarks/arguments.py [--against COMMIT]`.

Numba hands a named tuple over number by number: an array of n dimensions is 5 + 2n arguments. Prints a Markdown table
of the field, the state and the scratch of three problems, beside those of a checkout of the commit, if one is given.
"""

import argparse
import json
import os
import subprocess
import sys
from typing import Any

import numba
import numpy as np
from hydra import compose, initialize_config_dir
from numba.core.datamodel import default_manager
from same_results import HERE, RIG, TAGS, checkout

from lmd.pipelines.app import CONF
from lmd.pipelines.building import build_problem

PROBLEMS = {
    "the paper's problem": (),
    "localisation with tags": (*TAGS, "objective=localisation"),
    "a rig of two": ("room.spacing=1.5", "pdf.divisions=6", RIG),
    "localisation by a rig of two": (*TAGS, "pdf.divisions=6", RIG, "objective=localisation"),
}


def width(kinds: Any) -> int:
    """Count the leaves of a nested tuple of LLVM types."""
    return sum(map(width, kinds)) if isinstance(kinds, tuple) else 1


def arguments(value: Any) -> int:
    """Count the LLVM arguments that a value is passed as."""
    return width(default_manager.lookup(numba.typeof(value)).get_argument_type())


def counted() -> dict[str, tuple[int, int, int]]:
    """Of each problem the arguments of field, state and scratch."""
    found = {}
    for name, overrides in PROBLEMS.items():
        with initialize_config_dir(CONF, version_base="1.3"):
            problem = build_problem(compose("optimise", list(overrides)))
        field: Any = problem.objective.field(problem.evaluator)  # type: ignore[attr-defined] # they have one
        state = field.state(problem.start.draw(problem.scene.room, np.random.default_rng(0)))
        found[name] = arguments(field), arguments(state), arguments(field.scratch(state))
    return found


def before(commit: str) -> dict[str, tuple[int, int, int]]:
    """Numbers of arguments at a commit, from its checkout."""
    with checkout(commit) as code:
        path = os.pathsep.join([str(code), str(HERE / "benchmarks")])
        command, environment = [sys.executable, __file__, "--json"], os.environ | {"PYTHONPATH": path}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        found: dict[str, tuple[int, int, int]] = json.loads(done.stdout)
        return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Count the LLVM arguments of a move; prints Markdown.")
    parser.add_argument("--against", metavar="COMMIT", help="also those of a commit")
    parser.add_argument("--json", action="store_true", help="print the numbers alone")
    options = parser.parse_args()
    if options.json:
        print(json.dumps(counted()))
        return
    columns = {options.against: before(options.against)} if options.against else {}
    columns["now"] = counted()
    heads = [f"{name}: field + state + scratch" for name in columns]
    print(f"| problem | {' | '.join(heads)} |\n|{(1 + len(columns)) * ' --- |'}")
    for name in PROBLEMS:
        cells = [f"{' + '.join(map(str, each[name]))} = {sum(each[name])}" for each in columns.values()]
        print(f"| {name} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
