"""The parameters of a sweep are those that all its jobs share."""

import pytest
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.types import RunMode

from lmd.core.checks import InputError
from pipelines.app import CONF
from pipelines.operations.sweeps.names import sweep_title
from pipelines.operations.sweeps.shared import asked_values, shared_parameters


def swept(*overrides):
    """The configuration of a sweep as its callback gets it; `GlobalHydra` is set."""
    loader = GlobalHydra.instance().config_loader()
    cfg = loader.load_configuration("optimise", list(overrides), RunMode.MULTIRUN, validate_sweep_overrides=False)
    cfg.hydra.job.config_name = "optimise"
    return cfg


@pytest.fixture(autouse=True)
def _hydra():
    with initialize_config_dir(CONF, version_base="1.3"):
        yield


def shared(*overrides):
    cfg = swept(*overrides)
    return shared_parameters(cfg, asked_values(cfg))


def test_what_an_option_changes_elsewhere_is_not_shared():
    assert shared("optimiser=ega,sga", "seed=0,1")["encoding"] == "paper"
    mixed = shared("optimiser=ega,annealing", "seed=0,1", "objective.n=3")
    assert "encoding" not in mixed
    assert not [key for key in mixed if key.startswith(("optimiser", "seed"))]
    assert mixed["objective.n"] == 3


def test_jobs_of_several_experiments_share_no_problem():
    found = shared("experiment=debug,hall", "optimiser=ega")
    assert found["optimiser"] == "ega"
    assert not {"room", "room.spacing", "deployment.count", "tag", "camera"} & found.keys()


def test_the_values_of_each_key_are_known_before_a_job_begins():
    cfg = swept("optimiser=ega,sga", "optimiser=ega", "seed=range(3)", "+objective.n=2,3", "deployment.count=20")
    assert asked_values(cfg) == {"seed": ["0", "1", "2"], "+objective.n": ["2", "3"]}
    with pytest.raises(InputError, match=r"seed=range\(2,2\) has no values"):
        asked_values(swept("seed=range(2,2)"))


def test_a_sweep_is_named_by_what_varies():
    assert sweep_title(swept("objective.n=2,3", "objective.thold_p=0.5,0.7", "optimiser=ega,sga", "seed=0,1")) == (
        "n x thold_p x optimiser"
    )
    assert sweep_title(swept("seed=0,1")) == "seed"
    assert sweep_title(swept("experiment=landmark_count", "seed=0,1")) == "landmark_count"
    assert sweep_title(swept("experiment=debug,hall")) == "experiment"
    assert sweep_title(swept("hparams_search=ega", "experiment=debug")) == "search ega debug"
