"""The frozen problems: names, hashes, records. Scoring the records by the reference takes 6 s."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

import lmd.suite
from lmd.suite import documents
from lmd.suite.documents import FOLDER
from lmd.suite.frozen import best_path, reference_fitness

NAMES = lmd.suite.names()
RECORDED = [name for name in NAMES if lmd.suite.document(name).best is not None]
SLOW = {"hall", "robust_platform", "frc_four_cameras", "robust_lab", "rig"}  # half a minute or more by the reference


def test_there_are_two_sets():
    assert len(NAMES) >= 24
    assert set(lmd.suite.names("small")) < set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_the_hash_of_a_problem_is_frozen(name):
    frozen = lmd.suite.document(name)
    assert frozen.hash == frozen.digest, "a changed problem is a new version: give it a new hash and a new best value"
    assert len(frozen.budgets) == 3


def test_the_hash_depends_on_settings_and_files(tmp_path, monkeypatch):
    frozen = lmd.suite.document("frc_cameras")
    other = {**frozen.problem, "cameras": {**frozen.problem["cameras"], "count": 3}}
    assert replace(frozen, problem=other).digest != frozen.hash
    shutil.copytree(FOLDER, tmp_path / "problems")
    monkeypatch.setattr(documents, "FOLDER", tmp_path / "problems")
    assert frozen.digest == frozen.hash
    with (tmp_path / "problems" / "frc_2025.csv").open("a") as file:
        file.write("\n")
    assert frozen.digest != frozen.hash


def score(name):
    """The value of the record of a problem, by the reference where it can evaluate the problem."""
    box = lmd.suite.problem(name, threads=None)
    if best_path(lmd.suite.document(name)).suffix == ".yaml":
        cameras = box.problem.with_rig(lmd.suite.best_rig(name))
        return cameras.fitness_of(box.problem.tags)
    if len(box.objectives) > 1:
        from pymoo.indicators.hv import HV

        return float(
            HV(ref_point=np.zeros(2))(-np.array([box.values_of(each) for each in lmd.suite.best_deployments(name)]))
        )
    (deployment,) = lmd.suite.best_deployments(name)
    box.problem.scene.footprints.check(box.problem.labelled(deployment))
    return reference_fitness(box.problem, box.problem.labelled(deployment))


@pytest.mark.parametrize("name", [name for name in RECORDED if name not in SLOW])
def test_the_record_of_a_problem_has_its_value(name):
    frozen = lmd.suite.document(name)
    assert score(name) == pytest.approx(frozen.best.value, abs=1e-12)
    assert frozen.bound is None or frozen.best.value <= frozen.bound + 1e-12


@pytest.mark.thorough("lmd/suite", "lmd/sight", "lmd/objectives")
@pytest.mark.parametrize("name", [name for name in RECORDED if name in SLOW])
def test_the_record_of_a_slow_problem_has_its_value(name):
    assert score(name) == pytest.approx(lmd.suite.document(name).best.value, abs=1e-12)


@pytest.mark.parametrize("name", ["captured_room", "l_shape", "rig", "frc_cameras", "mixed_sizes"])
def test_the_settings_of_every_kind_of_room_are_json(name):
    assert json.loads(json.dumps(lmd.suite.problem(name).problem.settings()))["landmarks"] > 0
