"""The problems: names, hashes, instances, records and entries. Scoring the records by the reference takes 15 s."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import yaml
from support.processes import ROOT

import lmd.suite
from lmd.core.checks import InputError
from lmd.suite import documents
from lmd.suite.documents import BEST, FOLDER
from lmd.suite.families import HELD_OUT
from lmd.suite.records import hypervolume

NAMES = lmd.suite.names()
RECORDED = [name for name in NAMES if lmd.suite.document(name).best is not None]
# Three seconds or more by the reference.
SLOW = {"hall", "robust_platform", "frc_four_cameras", "robust_lab", "rig", "frc_cameras", "lab_localisation_60"}
SLOW |= {"lab_one_tag", "lab_pose", "lab_localisation", "lab_qualified", "captured_room", "mixed_sizes"}
SLOW |= {"localised_against_paper", "localised_against_tags"}


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


def check_record(name):
    """The record of a problem is what `verify` makes of it: an admissible candidate with its value."""
    frozen = lmd.suite.document(name)
    found = lmd.suite.verify(BEST / f"{name}.yaml")
    assert found.pop("value") == pytest.approx(frozen.best["value"], abs=1e-12)
    assert {**frozen.best, **found} == frozen.best
    assert (found["hash"], found["version"]) == (frozen.hash, frozen.version)
    assert frozen.bound is None or frozen.best["value"] <= frozen.bound + 1e-12


@pytest.mark.parametrize("name", [name for name in RECORDED if name not in SLOW])
def test_the_record_of_a_problem_has_its_value(name):
    check_record(name)


@pytest.mark.thorough("lmd/suite", "lmd/sight", "lmd/objectives")
@pytest.mark.parametrize("name", [name for name in RECORDED if name in SLOW])
def test_the_record_of_a_slow_problem_has_its_value(name):
    check_record(name)


def test_the_area_below_a_front_is_that_of_pymoo():
    from pymoo.indicators.hv import HV

    points = np.random.default_rng(0).random((12, 2))
    assert hypervolume(points) == pytest.approx(float(HV(ref_point=np.zeros(2))(-points)), abs=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_every_instance_is_a_problem_of_its_own_and_is_drawn_again_alike(name):
    frozen = lmd.suite.document(name)
    hashes = {frozen.hash}
    for instance in (1, 2, HELD_OUT):
        made = lmd.suite.document(f"{name}-{instance}")
        assert (made.budgets, made.best, made.bound) == (frozen.budgets, None, None)
        assert made.hash == made.digest
        hashes.add(made.hash)
    assert len(hashes) == 4
    lmd.suite.document.cache_clear()
    assert lmd.suite.document(f"{name}-2").hash in hashes


def test_an_instance_draws_the_room_the_camera_the_count_and_the_threshold():
    nodes = [lmd.suite.document(f"tiny_mean-{i}").problem for i in range(1, 41)]
    frozen = lmd.suite.document("tiny_mean").problem
    sizes = np.array([each["room"]["size"] for each in nodes]) / frozen["room"]["size"]
    inner = np.array([each["room"]["reachable_size"] for each in nodes]) / frozen["room"]["reachable_size"]
    np.testing.assert_allclose(sizes, inner, rtol=2e-3)
    assert (sizes.min(axis=0) >= [0.799, 0.799, 0.899]).all()
    assert (sizes.max(axis=0) <= [1.251, 1.251, 1.151]).all()
    assert (np.ptp(sizes, axis=0) > 0.15).all()
    assert {each["deployment"]["count"] for each in nodes} == {6, 7, 8, 9, 10}
    assert {type(each["deployment"]["count"]) for each in nodes} == {int}
    thresholds = [each["objective"]["thold_p"] for each in nodes]
    assert 0.425 <= min(thresholds) < 0.45 < 0.55 < max(thresholds) <= 0.575
    box = lmd.suite.problem("tiny_mean", instance=3)
    assert box.name == "tiny_mean-3"
    assert 0.0 <= box(box.start()) <= 1.0


def test_an_entry_is_scored_and_its_claim_is_not_read(tmp_path):
    box = lmd.suite.problem("tiny_mean", instance=HELD_OUT)
    genes = box.start(3)
    entry = {"problem": box.name, "who": "A", "how": "by hand", "when": "2026-11-29", "candidate": genes.tolist()}
    (tmp_path / "a.yaml").write_text(yaml.safe_dump(entry | {"value": 0.99}))
    record = lmd.suite.verify(tmp_path / "a.yaml")
    assert record["value"] == pytest.approx(float(box(genes)), abs=1e-12)
    assert record["off_grid"] == round(box.score(genes)["grid_free_average_coverage_probability"], 6)
    box.deployment(genes).to_csv(tmp_path / "landmarks.csv")
    (tmp_path / "b.yaml").write_text(yaml.safe_dump(entry | {"candidate": "landmarks.csv"}))
    command = [sys.executable, "-m", "lmd.suite", "b.yaml"]
    done = subprocess.run(command, cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
    assert yaml.safe_load(done.stdout)["value"] == pytest.approx(record["value"], abs=1e-12), done.stderr


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"who": ""}, "an entry has the keys problem, who, how, when, candidate; who is missing"),
        ({"when": "yesterday"}, "when must be a date such as 2026-11-29, got 'yesterday'"),
        ({"problem": "tiny"}, "suite must be one of .*, got 'tiny'"),
        ({"problem": "tiny_mean-x"}, "an instance must be a number, as in tiny_mean-3, got 'tiny_mean-x'"),
        ({"candidate": [0.5] * 3}, r"genes must have the shape \(16,\), got \(3,\)"),
        ({"candidate": "absent.csv"}, "absent.csv"),
        ({"candidate": "few.csv"}, "count = 8, but .*few.csv has 1 landmarks"),
    ],
)
def test_an_entry_that_is_none_is_refused(tmp_path, change, message):
    (tmp_path / "few.csv").write_text("id,x,y,z,nx,ny,nz\n0,0,1,1,1,0,0\n")
    entry = {"problem": "tiny_mean", "who": "A", "how": "b", "when": "2026-11-29", "candidate": "few.csv"}
    (tmp_path / "a.yaml").write_text(yaml.safe_dump(entry | change))
    with pytest.raises(InputError, match=rf"a.yaml: .*{message}"):
        lmd.suite.verify(tmp_path / "a.yaml")


@pytest.mark.parametrize("name", ["captured_room", "l_shape", "rig", "frc_cameras", "mixed_sizes"])
def test_the_settings_of_every_kind_of_room_are_json(name):
    assert json.loads(json.dumps(lmd.suite.problem(name).problem.settings()))["landmarks"] > 0
