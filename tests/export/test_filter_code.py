"""Code for filters computes the laws; the Java compiler takes some seconds."""

import math
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lmd.core.checks import InputError
from lmd.estimation.deviation_law import QUANTITIES, Law, PowerLaw, Rule
from lmd.export.filter_code import CLASS, FilterLaws, java

BOTH = {name: Law(PowerLaw(1e-5 + 0.01 * i, 2.0 + i), PowerLaw(0.02, 1.5, 0.75)) for i, name in enumerate(QUANTITIES)}
RULES = {shape: {name: Rule(shape, 0.4, 0.05) for name in QUANTITIES} for shape in ("squared", "photonvision")}
LAWS = FilterLaws(BOTH, RULES, 2.5, 0.5, 6.0, "24 tags of 0.15 m.")


def expected(distance, tags):
    """By hand: the law ends at the range of the views, and for a single tag at the reach."""
    if tags == 1 and distance > LAWS.reach:
        return [sys.float_info.max] * 3
    at = np.array([np.clip(distance, LAWS.nearest, LAWS.farthest)]), np.array([tags])
    position, heading = (float(LAWS.laws[name].at(*at)[0]) for name in ("horizontal", "heading"))
    return [position, position, heading]


CASES = [(1.0, 1), (2.5, 1), (2.6, 1), (0.1, 1), (3.0, 2), (9.0, 5)]


@pytest.mark.skipif(shutil.which("javac") is None, reason="no Java compiler")
def test_java_code_computes_the_laws(tmp_path):
    """Compile the class with stubs of WPILib's types, and run it."""
    calls = "".join(
        f"print({CLASS}.stdDevs({d}, {n}));" for d, n in CASES
    )  # fmt: skip
    main = (
        "package frc.robot; public class Main { static void print(edu.wpi.first.math.Matrix<?, ?> m) "
        '{ System.out.println(m.v[0] + " " + m.v[1] + " " + m.v[2]); } '
        f"public static void main(String[] a) {{ {calls} print({CLASS}.kMultiTagStdDevs); }} }}"
    )
    stubs = Path(__file__).with_name("stubs")
    for name, text in ((f"{CLASS}.java", java(LAWS)), ("Main.java", main)):
        (tmp_path / name).write_text(text)
    files = [*(tmp_path.glob("*.java")), *stubs.rglob("*.java")]
    subprocess.run(["javac", "-d", ".", "-Xlint:all", "-Werror", *files], cwd=tmp_path, check=True, timeout=120)
    done = subprocess.run(["java", "frc.robot.Main"], cwd=tmp_path, check=True, capture_output=True, timeout=120)
    rows = [[float(value) for value in line.split()] for line in done.stdout.decode().splitlines()]
    for row, case in zip(rows, CASES, strict=False):
        assert row == pytest.approx(expected(*case), rel=1e-4)
    assert rows[-1] == [0.05, 0.05, 0.05]


def test_without_a_limit_a_single_tag_is_always_known():
    free = FilterLaws(BOTH, RULES, math.inf, 0.5, 6.0, "tags")
    assert "SINGLE_TAG_REACH = Double.POSITIVE_INFINITY;" in java(free)
    with pytest.raises(InputError, match="about must be a single line"):
        FilterLaws(BOTH, RULES, math.inf, 0.5, 6.0, "a\nb")
