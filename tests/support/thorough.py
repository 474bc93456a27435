"""Tests that `make test` leaves out: `@pytest.mark.thorough("pipelines/operations", ...)`.

`LMD_THOROUGH=all` runs them all, as `make test-thorough` does. `LMD_THOROUGH=REVISION` runs those whose paths have
changed since that revision, as `.ci/run` does. Paths are files or folders from the root of the project; beside those
that the mark names, the test's own file, and the rest of `tests` that is not a test, count.
"""

import os
import subprocess
from functools import cache
from pathlib import Path

from hypothesis import settings

ROOT = Path(__file__).resolve().parents[2]
ALL = "all"
ASKED = os.environ.get("LMD_THOROUGH", "")


def is_due(item, asked=ASKED):
    """True if a collected test runs."""
    marks = list(item.iter_markers("thorough"))
    if not marks or asked == ALL:
        return True
    if not asked:
        return False
    paths = (str(item.path.relative_to(ROOT)), *(path for mark in marks for path in mark.args))
    return any(touches(path, changed) for path in paths for changed in changes(asked))


def touches(path, changed):
    """True if `changed` is `path` or lies below it."""
    return changed == path or changed.startswith(f"{path}/")


@cache
def changes(revision):
    """Files that differ from those of a revision; all files if git cannot say."""
    command = ["git", "-C", ROOT, "diff", "--name-only", revision, "--"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        return [
            str(path.relative_to(ROOT)) for folder in ("lmd", "pipelines") for path in (ROOT / folder).rglob("*.py")
        ]
    return done.stdout.split()


SHARE = float(os.environ.get("LMD_EXAMPLES", "0.2"))
DEFAULT = 100  # number of examples of a test without its own


def examples(number):
    """Settings of a test with this number of examples; no deadline, as the first may wait for a compiler."""
    return settings(max_examples=max(1, round(SHARE * number)), deadline=None)
