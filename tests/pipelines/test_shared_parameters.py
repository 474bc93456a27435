"""The parameters of a sweep are those that all its jobs share."""

import atexit
import threading

import pytest
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.types import RunMode
from omegaconf import read_write

from lmd.core.checks import InputError
from pipelines.app import CONF
from pipelines.operations.sweeps.callback import SweepRecord, _cut_short
from pipelines.operations.sweeps.folder import Sweep, SweepFolder
from pipelines.operations.sweeps.names import job_folder, pin_sweep_folder, sweep_folder, sweep_title
from pipelines.operations.sweeps.shared import asked_values, shared_parameters
from pipelines.operations.sweeps.supervisor import SWEEP_VARIABLE
from pipelines.outputs import held
from pipelines.overrides import forced, key_and_value


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
    assert shared("optimiser=ega,sga", "seed=0,1")["encoding.kind"] == "paper"
    mixed = shared("optimiser=ega,annealing", "seed=0,1", "objective.n=3")
    assert "encoding.kind" not in mixed
    filtered = shared("objective=filtered", "seed=0,1")  # mlflow's names have no @
    assert (filtered["objective.trajectory"], [key for key in filtered if "@" in key]) == ("random_drives", [])
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


def pinned(folder, *overrides):
    """The configuration of a sweep in a folder, with its overrides as they were given."""
    cfg = swept(*forced(["hydra.mode=MULTIRUN", *overrides]))
    with read_write(cfg.hydra):
        cfg.hydra.sweep.dir = str(folder)
    pin_sweep_folder(cfg)
    assert cfg.hydra.overrides.task == list(overrides)
    return cfg


def test_a_key_of_the_chosen_options_may_be_fixed(tmp_path):
    cfg = pinned(tmp_path, "optimiser=ega,ega_tuned", "optimiser.eliminated=2,7", "optimiser.population=12")
    assert shared_parameters(cfg, asked_values(cfg))["objective.n"] == 2
    for options, wrong, key, lacks, has in (
        ("optimiser=ega,ega_tuned", "nosuch=1", "optimiser.nosuch", "optimiser=ega", r"acceptance, .*population"),
        ("optimiser=ega,annealing", "population=12", "optimiser.population", "optimiser=annealing", "climb_share, "),
        ("room=lab,hall", "nosuch.deep=1", "room.nosuch.deep", "room=lab", "spacing"),
    ):
        cfg = pinned(tmp_path, options, f"{options.partition('=')[0]}.{wrong}")
        with pytest.raises(InputError, match=rf"^{key} is no key of {lacks}: there are .*{has}"):
            shared_parameters(cfg, asked_values(cfg))


@pytest.mark.parametrize(
    ("given", "is_sweep"), [("-m", True), ("experiment=optimisers", True), ("experiment=lab", False), ("seed=0", False)]
)
def test_only_a_sweep_forces_its_overrides(given, is_sweep):
    both = ["optimiser.population=12", "tracking.uri=a"]
    assert forced([given, *both]) == [given, f"{'++' * is_sweep}optimiser.population=12", both[1]]
    assert forced([given, *both, "hydra.mode=RUN"])[1:3] == both  # a job of the sweep


@pytest.mark.parametrize(
    "same",
    [
        "+tracking.tags.study='a b'", "++tracking.tags={a: b}", "~tracking.tags", "tracking=none", "threads=1",
        "picture=false", "checkpoint_seconds=5", "export=[csv]", "trust=[numpy]", "resume=here",
    ],
)  # fmt: skip
def test_what_changes_no_result_is_no_part_of_a_jobs_identity(tmp_path, same):
    one, other = swept("optimiser=ega,sga", "seed=0,1"), swept("optimiser=ega,sga", "seed=0,1", same)
    assert sweep_folder(_root_=one) == sweep_folder(_root_=other)
    assert sweep_folder(_root_=one) != sweep_folder(_root_=swept("optimiser=ega,sga", "seed=0,1", "validate=false"))
    jobs = [pinned(tmp_path, "seed=1"), pinned(tmp_path, "seed=1", same), pinned(tmp_path, "seed=1", "objective.n=3")]
    SweepFolder(tmp_path).save(Sweep("s", ("seed",), None))
    names = [job_folder(_root_=job) for job in jobs]
    assert names[0] == names[1] != names[2]
    SweepFolder(tmp_path).save(Sweep("s", ("seed", key_and_value(same)[0]), None))  # jobs that vary it are several
    assert job_folder(_root_=jobs[1]) != names[0] == job_folder(_root_=jobs[0])


def test_sweeps_that_begin_at_once_begin_one_after_the_other(tmp_path, monkeypatch):
    monkeypatch.setenv(SWEEP_VARIABLE, "")
    record, cfg = tmp_path / "sweep.json", pinned(tmp_path, "seed=0,1", "tracking=none")
    second = threading.Thread(target=SweepRecord().on_multirun_start, args=(cfg,))
    with held(tmp_path):
        second.start()
        second.join(0.5)
        assert second.is_alive()
        assert not record.exists()
    second.join(60)
    atexit.unregister(_cut_short)
    assert record.exists()


def test_a_sweep_is_named_by_what_varies():
    assert sweep_title(swept("objective.n=2,3", "objective.thold_p=0.5,0.7", "optimiser=ega,sga", "seed=0,1")) == (
        "n x thold_p x optimiser"
    )
    assert sweep_title(swept("seed=0,1")) == "seed"
    assert sweep_title(swept("experiment=landmark_count", "seed=0,1")) == "landmark_count"
    assert sweep_title(swept("experiment=debug", "room=lab", "objective.n=2,3")) == "n experiment=debug room=lab"
    assert sweep_title(swept("experiment=debug,hall")) == "experiment"
