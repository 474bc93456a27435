"""Code for filters computes the laws; the Java compiler takes some seconds."""

import math
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from lmd.core.checks import InputError
from lmd.estimation.deviation_law import QUANTITIES, Law, PowerLaw, Rule
from lmd.export.filter_code import CLASS, FilterLaws, java, python

BOTH = {name: Law(PowerLaw(1e-5 + 0.01 * i, 2.0 + i), PowerLaw(0.02, 1.5, 0.75)) for i, name in enumerate(QUANTITIES)}
RULES = {shape: {name: Rule(shape, 0.4, 0.05) for name in QUANTITIES} for shape in ("squared", "photonvision")}
LAWS = FilterLaws(BOTH, RULES, 2.5, 0.5, 6.0, "24 tags of 0.15 m.")
CASES = [(1.0, 1), (2.5, 1), (2.6, 1), (0.1, 1), (3.0, 2), (9.0, 5)]


def expected(distance, tags):
    found = LAWS.deviations(distance, tags)
    return [min(value, sys.float_info.max) for value in (found[0], found[0], found[1])]


def test_the_laws_end_at_the_reach_and_at_the_range_of_the_views():
    assert LAWS.deviations(2.6, 1) == [math.inf] * 2
    assert LAWS.deviations(0.1, 1) == LAWS.deviations(0.5, 1)
    assert LAWS.deviations(9.0, 2) == LAWS.deviations(6.0, 2)
    assert LAWS.deviations(4.0, 4, ["vertical"]) == [pytest.approx(0.02 * 4.0**1.5 / 4.0**0.75)]


def test_python_code_computes_the_laws():
    space = {}
    exec(python(LAWS), space)
    for case in CASES:
        assert space["std_devs"](*case) == pytest.approx(expected(*case), rel=1e-4)
    assert space["std_devs"](1.0, 0)[0] == sys.float_info.max
    assert space["MULTI_TAG_STD_DEVS"] == (0.05, 0.05, 0.05)
    assert space["SINGLE_TAG_STD_DEVS"] == (0.4, 0.4, 0.4)


def test_wpilib_takes_what_the_python_code_returns():
    estimator = pytest.importorskip("wpimath.estimator")
    geometry, kinematics = pytest.importorskip("wpimath.geometry"), pytest.importorskip("wpimath.kinematics")
    space = {}
    exec(python(LAWS), space)
    here = geometry.Pose2d()
    found = estimator.DifferentialDrivePoseEstimator(
        kinematics.DifferentialDriveKinematics(0.5), geometry.Rotation2d(), 0.0, 0.0, here
    )
    found.setVisionMeasurementStdDevs(space["std_devs"](2.0, 2))


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
