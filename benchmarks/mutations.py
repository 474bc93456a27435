"""Mutations of the library, and the quick test that kills each: `python benchmarks/mutations.py [PACKAGE ...]`.

One for each package: a flipped sign, a missing factor or a swapped axis. Each is made in a worktree of the last commit,
where quick tests of the package run until one fails. Prints a Markdown table; the exit code is 1 if one survives.
`--page` writes the tests to docs/results/suite.md.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "results" / "suite.md"
LIST = re.compile(r"(?<=one of these quick tests:\n\n)(- .*\n)+")
FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+?)(?:\[.*)?(?: - .*)?$", re.MULTILINE)


class Mutation(NamedTuple):
    """A change of one place of a file, and the tests that shall notice."""

    file: str
    """Path below `lmd`."""
    before: str
    """Text that occurs once."""
    after: str
    """Text in its place."""
    tests: str
    """File in the folder of the package in `tests`."""


MUTATIONS = (
    Mutation("adjust/motion.py", "at_frames(far[:, None, None] * each)", "at_frames(each)", "test_motion.py"),
    Mutation("cameras/mounts.py", "return low + share * (high", "return low - share * (high", "test_body.py"),
    Mutation("core/memory.py", "there = 1024.0 * float", "there = float", "test_memory.py"),
    Mutation("detection/corner_errors.py", "axis=-1)) / depth**3", "axis=-1)) / depth**2", "test_quality.py"),
    Mutation("estimation/pairs.py", "share[name] - share[first]", "share[first] - share[name]", "test_pairs.py"),
    Mutation("evaluation/losses.py", "lost = self.fitness - alone", "lost = alone", "test_losses.py"),
    Mutation("export/paper.py", "columns * plate) / 2.0", "columns * plate)", "test_sheets.py"),
    Mutation("formats/placed_tag.py", "from_quat([x, y, z, w])", "from_quat([y, x, z, w])", "test_keyed_files.py"),
    Mutation("geometry/frames.py", "zero, -np.sin(a)), (zero", "zero, np.sin(a)), (zero", "test_frames.py"),
    Mutation("incremental/camera.py", "(was == 0) != (now", "(was == 0) == (now", "test_hiding.py"),
    Mutation("localise/changes.py", "covariances[k] @ force", "-covariances[k] @ force", "test_displacement.py"),
    Mutation(
        "objectives/localisation/information.py",
        "(squared * np.sqrt(squared))",
        "squared",
        "test_information.py",
    ),
    Mutation("optimisers/encoding.py", "(2.0 * g[..., 3] - 1.0)", "(g[..., 3] - 1.0)", "test_encoding.py"),
    Mutation("orientation/density.py", "2.0 * np.pi) - np.pi)", "2.0 * np.pi))", "test_recording.py"),
    Mutation("planner/viewing.py", "(below + above) / 2.0 for", "(below + above) for", "test_viewing.py"),
    Mutation("plot/common.py", "np.partition(distances, 1)[1]", "np.partition(distances, 1)[0]", "test_plot.py"),
    Mutation("render/imaging.py", "(1.0 / self.gamma)", "self.gamma", "test_render.py"),
    Mutation("scene/rig.py", "(forward, -right, np.cross", "(forward, right, np.cross", "test_rig.py"),
    Mutation(
        "sight/models/paper.py",
        "-dot(normals, offset) <= TOL",
        "dot(normals, offset) <= TOL",
        "test_reference.py",
    ),
    Mutation("space/surface.py", "a[..., None] * self.u + b[", "a[..., None] * self.v + b[", "test_cuboid.py"),
    Mutation("suite/adapters.py", "] = -problem(", "] = problem(", "test_adapters.py"),
    Mutation("survey/keyframes.py", "following - since <= LONG", "following - since >= LONG", "test_keyframes.py"),
)


def killer(tree: Path, mutation: Mutation) -> str | None:
    """The first test that fails with a mutation in a worktree, without its parameters; None if all pass."""
    path = tree / "lmd" / mutation.file
    text = path.read_text()
    assert text.count(mutation.before) == 1, f"{mutation.file} has {text.count(mutation.before)} x {mutation.before!r}"
    path.write_text(text.replace(mutation.before, mutation.after))
    tests = f"tests/{mutation.file.partition('/')[0]}/{mutation.tests}"
    line = [sys.executable, "-m", "pytest", "-n0", "-x", "-q", "-p", "no:cacheprovider", tests]
    try:
        done = subprocess.run(line, cwd=tree, env=os.environ | {"PYTHONPATH": "."}, capture_output=True, text=True)
    finally:
        path.write_text(text)
    found = FAILED.search(done.stdout)
    return found[1].removeprefix("tests/") if found else None


def main() -> None:
    """Make each mutation and print what kills it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("packages", nargs="*", help="packages of lmd; all by default")
    parser.add_argument("--page", action="store_true", help="write the table to docs/results/suite.md")
    asked = parser.parse_args()
    tests: list[str | None] = []
    print("| mutation | killed by |\n| --- | --- |")
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        subprocess.run(["git", "-C", ROOT, "worktree", "add", "--quiet", "--detach", tree], check=True)
        try:
            for mutation in MUTATIONS:
                if not asked.packages or mutation.file.partition("/")[0] in asked.packages:
                    tests.append(killer(tree, mutation))
                    change = f"`{mutation.before}` to `{mutation.after}` in `{mutation.file}`"
                    print(f"| {change} | {tests[-1] or 'nothing'} |", flush=True)
        finally:
            subprocess.run(["git", "-C", ROOT, "worktree", "remove", "--force", tree], check=True)
    if asked.page:
        PAGE.write_text(LIST.sub("".join(f"- `{test}`\n" for test in tests), PAGE.read_text()))
    sys.exit(None in tests)


if __name__ == "__main__":
    main()
