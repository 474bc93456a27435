"""The set covers of `benchmarks/ocp.py`: files, the greedy selection, and both programs against all choices."""

import subprocess
import sys
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from lmd.core.checks import InputError

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
import ocp  # benchmarks are scripts beside each other


def written(path, covers):
    """Write an instance in the format of the competition."""
    lines = ["{} {}".format(*covers.shape)]
    for sample, row in enumerate(covers):
        lines += [str(sample), str(row.sum()), " ".join(map(str, np.flatnonzero(row)))]
    path.write_text("\n".join(lines))
    return path


@pytest.fixture(name="covers")
def _covers():
    covers = np.random.default_rng(5).random((30, 12)) < 0.25
    covers[~covers.any(axis=1), 0] = True
    return covers


def needed(covers):
    """The fewest candidates that cover all samples."""
    sizes = range(1, covers.shape[1] + 1)
    return next(k for k in sizes if any(covers[:, c].any(axis=1).all() for c in combinations(range(12), k)))


def test_the_programs_find_the_fewest_cameras_and_the_greedy_selection_takes_no_fewer(covers, tmp_path):
    cover, fewest = ocp.Cover.read(written(tmp_path / "a.txt", covers)), needed(covers)
    np.testing.assert_array_equal(cover.covers.toarray() > 0.0, covers)
    assert ocp.fewest(cover, 10.0) == (fewest, fewest)
    assert fewest <= ocp.greedy(cover) < 12
    assert ocp.covered(cover, fewest, 10.0) == (30, True)
    most = max(covers[:, c].any(axis=1).sum() for c in combinations(range(12), fewest - 1))
    assert ocp.covered(cover, fewest - 1, 10.0) == (most, True)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "must begin with the numbers of samples and of candidates"),
        ("a b", "no file of whole numbers"),
        ("1 2 0 1 2", "sample 0 must have its index, and a count of candidates below 2"),
        ("1 2 0 2 1", "sample 0 must have"),
        ("2 2 0 1 1", "sample 1 must have"),
        ("1 2 0 0", "sample 0 must have"),
        ("1 2 0 1 1 7", "1 numbers follow the 1 samples"),
    ],
)
def test_a_file_that_is_no_instance_is_refused_in_a_sentence(text, message, tmp_path):
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(InputError, match=message):
        ocp.Cover.read(tmp_path / "a.txt")


@pytest.mark.slow
def test_the_command_prints_a_row(covers, tmp_path):
    command = [sys.executable, ocp.__file__, str(written(tmp_path / "a.txt", covers))]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith(f"| a | 30, 12 | {ocp.greedy(ocp.Cover.read(tmp_path / 'a.txt'))} |")
