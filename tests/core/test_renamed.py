"""What earlier versions wrote still works."""

import importlib
from functools import partial

import pytest
from small import composed, problem

from lmd.core.checks import InputError
from lmd.core.renamed import renamed
from lmd.optimisers.checkpoint import Checkpoint
from lmd.optimisers.ledger import Budget
from lmd.optimisers.random_search import RandomSearch
from pipelines.app import flat_settings
from pipelines.earlier_settings import settings_now
from pipelines.trust import read_yaml

EGA, ANNEALING = "lmd.optimisers.ega.EGA", "lmd.optimisers.annealing.Annealing"
# What the project's own configurations named before the packages were rearranged.
TARGETS = [
    "lmd.camera.Camera",
    "lmd.camera_calibration.calibrated_camera",
    "lmd.deployment.FileDeployment",
    "lmd.deployment.RandomDeployment",
    "lmd.deployment.UniformDeployment",
    "lmd.localisation.estimators.CramerRaoBound",
    "lmd.localisation.fusion.FixedLagSmoother",
    "lmd.localisation.fusion.InvariantKalmanFilter",
    "lmd.localisation.measurements.Detector",
    "lmd.localisation.observer.Observer",
    "lmd.localisation.odometry.Odometry",
    "lmd.localisation.pnp.PerspectiveNPoint",
    "lmd.localisation.rendered.RenderedDetector",
    "lmd.localisation.study.InitialError",
    "lmd.localisation.tags.noisy_detector",
    "lmd.localisation.trajectory.FileTrajectory",
    "lmd.localisation.trajectory.Pace",
    "lmd.localisation.trajectory.RandomMotion",
    "lmd.localisation.trajectory.Waypoints",
    "lmd.mounting.MountingError",
    "lmd.pdf.from_csv",
    "lmd.pdf.grid_of_cells",
    "lmd.pdf.grid_with_ends",
    "lmd.pdf.level_flight",
    "lmd.pdf.solid_angle",
    "lmd.recorded_poses.RecordedPoses",
    "lmd.sight.fiducial.Fiducial",
    "lmd.sight.paper.Visibility",
    "lmd.tag.Tag",
]


@pytest.mark.parametrize("target", TARGETS)
def test_a_name_of_an_earlier_version_leads_to_what_it_named(target):
    module, _, name = renamed(target).rpartition(".")
    assert renamed(target) != target
    assert getattr(importlib.import_module(module), name).__name__ == name


@pytest.mark.parametrize("target", ["lmd.optimisers.ega.EGA", "lmd.tags.Tag", "mine.lmd.tag.Tag", "lmd.tag"])
def test_other_names_stay(target):
    assert renamed(target) == target


def test_the_configuration_of_an_earlier_run_is_read_by_its_new_names(tmp_path):
    file = tmp_path / "config.yaml"
    file.write_text(
        "tag: {_target_: lmd.tag.Tag, edge: 0.1}\ncamera: {rig: [{camera: {_target_: lmd.camera.Camera}}]}\n"
    )
    found = read_yaml(file, "run")
    assert found["tag"] == {"_target_": "lmd.scene.tag.Tag", "edge": 0.1}
    assert found["camera"]["rig"][0]["camera"]["_target_"] == "lmd.geometry.camera.Camera"


def test_its_checkpoint_is_gone_on_from(tmp_path):
    small, search = problem(), RandomSearch(seed=0)
    search.run(small, Budget(20))
    Checkpoint(search, {"tag._target_": "lmd.tag.Tag"}).save(tmp_path)
    again = RandomSearch(seed=0)
    Checkpoint(again, {"tag._target_": "lmd.scene.tag.Tag"}).resume(tmp_path, small)
    assert again.ledger.evaluations == 20


@pytest.mark.parametrize(
    ("then", "overrides"),
    [
        ({"optimiser._target_": EGA, "optimiser.encoding": "paper", "encoding.kind": "wall"}, ["optimiser=ega"]),
        ({"optimiser._target_": EGA, "encoding.kind": "wall"}, ["optimiser=ega", "encoding=wall"]),
        ({"optimiser._target_": ANNEALING, "optimiser.single.jump": 0.2}, ["optimiser.single.jump=0.2"]),
    ],
)
def test_the_settings_of_an_earlier_run_had_the_defaults_of_the_optimisers_class(then, overrides):
    cfg = composed("optimise", *overrides)
    now = settings_now(flat_settings(cfg, "optimiser", "encoding"), cfg)
    assert settings_now({"encoding.flush": True, "encoding.kind": "wall"} | then, cfg) == now


def test_they_differ_where_one_is_no_longer_at_its_default(tmp_path):
    small, search, cfg = problem(), RandomSearch(seed=0), composed("optimise", "optimiser=random_search")
    search.run(small, Budget(20))
    Checkpoint(search, {"encoding.kind": "wall"}).save(tmp_path)
    as_now = partial(settings_now, cfg=cfg)
    now = as_now({"optimiser.batch": 10, "encoding.kind": "wall"})
    with pytest.raises(InputError, match=r"was made with optimiser\.batch = 30, not 10"):
        Checkpoint(RandomSearch(seed=0), now, settings_now=as_now).resume(tmp_path, small)
