"""Settings that are refused: in one sentence that begins with the whole key."""

import re

import pytest
from composing import composed
from processes import refused

from lmd.core.checks import InputError
from pipelines.building import build_optimiser, build_problem
from pipelines.nodes import instantiate, keyed
from pipelines.pipeline import _refuse_configuration_of_another

# Overrides of `evaluate`, and how the refusal begins.
REFUSED = {
    "objective.thold_p=1.2": "objective.thold_p must be in [0, 1], got 1.2.",
    "room.size=[1,2]": "room.size must be a list of 3 numbers, got [1, 2].",
    "+camera.zoom=2": "camera.zoom is no setting that is known",
    "room.spacing=1e-3": "room.spacing = 0.001 makes 9.45e+10 positions, which would take",
    "room.spacing=null": "room.spacing must be a number, got None.",
    "room.relevance.regions=[{low: [20, 20, 20], high: [21, 21, 21], weight: 3}]": (
        "room.relevance.regions[0] from [20, 20, 20] to [21, 21, 21] holds no position"
    ),
    "camera.image_width=1640.5": "camera.image_width must be a whole number, got 1640.5.",
    "encoding.flush=foo": "encoding.flush must be true or false, got 'foo'.",
    "validate=foo": "validate must be true or false, got 'foo'.",
    "picture=3": "picture must be true or false, got 3.",
    "sensitivity=maybe": "sensitivity must be true or false, got 'maybe'.",
    "localisation=1": "localisation must be true or false, got 1.",
    "tag.edge=100": "tag.edge is too large: surface x_min is 5 m wide",
    "camera.focal_length=-2": "camera.focal_length must be greater than 0, got -2.",
    "room.relevance.background=-1": "room.relevance.background must be at least 0, got -1.",
    "room.relevance.path=none.csv": "room.relevance.path: there is no file 'none.csv'.",
    "room.relevance.background=0": "room.relevance.background gives every position the weight 0.",
    "room.relevance.regions=[{low: [0, 0], high: [1, 1, 1], weight: 1}]": "room.relevance.regions[0].low must be a",
    "pdf=recorded": "pdf=recorded needs poses=recorded.",
    "pdf.divisions=0": "pdf.divisions must be at least 1, got 0.",
    "objective.sampling.positions=0": "objective.sampling.positions must be at least 1, got 0.",
    "objective.n=91": "objective.n = 91 exceeds the number of landmarks, 90.",
    "deployment.count=0": "deployment.count must be at least 1, got 0.",
    "threads=0": "threads must be in [1, 1024], got 0.",
    "encoding.kind=tree": "encoding.kind must be one of wall, paper, got 'tree'.",
}
# Of `observe`.
PARTS = {
    "trajectory.pace.speed=0": "trajectory.pace.speed must be greater than 0, got 0.",
    "estimator.iekf.least_turn_noise=0": "estimator.iekf.least_turn_noise must be greater than 0, got 0.",
    "start.position=-1": "start.position must be at least 0, got -1.",
    "odometry.turn_noise=-1": "odometry.turn_noise must be at least 0, got -1.",
    "sensor.missed=2": "sensor.missed must be in [0, 1], got 2.",
}


@pytest.mark.parametrize("override", REFUSED)
def test_a_problem_that_is_refused_names_the_whole_key(override):
    with pytest.raises(InputError, match="^" + re.escape(REFUSED[override])):
        build_problem(composed("evaluate", "objective=robust", "deployment=uniform", override))


@pytest.mark.parametrize("override", PARTS)
def test_a_part_that_is_refused_names_the_whole_key(override):
    cfg = composed("observe", "estimator=[iekf]", override)
    group, name = override.split(".")[:2]
    with pytest.raises(InputError, match="^" + re.escape(PARTS[override])):
        instantiate(cfg.estimator[name] if group == "estimator" else cfg[group])


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("optimiser.single.temperature=[-1,1]", "optimiser.single.temperature[0] must be greater than 0, got -1."),
        ("optimiser.growth=2", "optimiser.growth must be in [0, 1], got 2."),
        ("seed=-1", "seed must be in [0, 3.40282e+38], got -1."),
    ],
)
def test_an_optimiser_that_is_refused_names_the_whole_key(override, message):
    cfg = composed("optimise", override)
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        build_optimiser(cfg, cfg.seed)


def test_a_key_is_that_of_the_group_or_one_of_its_own_or_none():
    def refused(error, group="", **keys):
        with pytest.raises(InputError) as caught, keyed(group, **keys):
            raise error
        return str(caught.value)

    assert refused(InputError("n is odd.", "n"), "objective") == "objective.n is odd."
    assert refused(InputError("size[0] is odd.", "size[0]"), "room") == "room.size[0] is odd."
    assert refused(InputError("kind is odd.", "kind"), "objective", kind="encoding.kind") == "encoding.kind is odd."
    assert refused(InputError("gain is odd.", "gain").within("a").within("all"), all="each") == "each.a.gain is odd."
    assert refused(InputError("room.size is odd.", "room.size"), "room") == "room.size is odd."
    assert refused(InputError("The file is odd."), "room") == "The file is odd."


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["tag.edge=-1"], r"^tag\.edge must be positive"),
        (["tag.edge=0.1", "tag.family=16h5"], r"^tag\.family 16h5 has 30 different tags, too few for 90"),
        (["visibility=fiducial"], r"^tag must have an edge"),
        (["tag.edge=1.5"], r"^deployment\.count = 90 tags do not fit: \d+ papers of 1\.875 m"),
        (["visibility=fiducial", "tag.edge=0.1", "visibility.detector=eyes"], r"^visibility\.detector eyes was not"),
        (["pdf.roll=[[0,0.5]]"], r"^pdf\.roll: the probabilities must sum to 1"),
        (["camera.distortion=[1]"], r"^camera\.distortion must be \[\] or \[k1, k2, p1, p2\]"),
        (["visibility=fiducial", "tag.edge=0.1", "visibility.detector=a.yaml"], r"^visibility\.detector: there is no"),
        (["visibility=fiducial", "tag.edge=0.1", "+visibility.limits.pitch=-1"], r"^visibility\.limits\.pitch must be"),
    ],
)
def test_what_cannot_be_is_refused_with_its_key(overrides, message):
    with pytest.raises(InputError, match=message):
        build_problem(composed("optimise", *overrides))


def test_what_an_experiment_sets_for_another_choice_is_said_to_be_its(tmp_path):
    message = "deployment.path is no setting that is known; experiment=frc_2025 sets it for another deployment"
    overrides = ("experiment=frc_2025", "deployment=random", "hydra.run.dir=run")
    refused("optimise", *overrides, message=message, cwd=tmp_path, settings=())
    (tmp_path / "optimiser").mkdir()
    (tmp_path / "optimiser/own.yaml").write_text("_target_: lmd.optimisers.ega.EGA\npopulaton: 3\n")
    message = r"optimiser.populaton is no setting that is known; did you mean optimiser.population?"
    overrides = ("experiment=debug", f"hydra.searchpath=[{tmp_path}]", "optimiser=own", "hydra.run.dir=run")
    refused("optimise", *overrides, message=message, cwd=tmp_path, settings=())


class Half:
    n = 1


@pytest.mark.parametrize(
    ("group", "page", "lacks"),
    [("objective", "objectives", "has no sampling, headline"), ("visibility", "scene", "has no needs_roll, spacing")],
)
def test_a_part_of_ones_own_that_lacks_a_method_is_named(group, page, lacks):
    cfg = composed("evaluate", "deployment=uniform")
    cfg[group] = {"_target_": f"{__name__}.Half"}
    with pytest.raises(InputError, match=rf"^{group} is a {__name__}\.Half, which {lacks}.*; docs/api/{page}\.md"):
        build_problem(cfg)


@pytest.mark.parametrize(
    "option", [["--config-name", "evaluate"], ["--config-name=evaluate.yaml"], ["-cn", "evaluate"]]
)
def test_the_configuration_of_another_command_is_refused(option, monkeypatch):
    monkeypatch.setattr("sys.argv", ["optimise", *option])
    with pytest.raises(
        SystemExit, match=r"^error: --config-name evaluate\S* is the configuration of another command: "
    ):
        _refuse_configuration_of_another("optimise")
    _refuse_configuration_of_another("evaluate")
