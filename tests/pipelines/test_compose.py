"""The configuration of a command from Python, as in a notebook."""

import re
from pathlib import Path

import pytest
from hydra import compose, initialize_config_module
from hydra.errors import HydraException

import lmd.suite
import pipelines
from lmd.core.checks import InputError
from pipelines.building import build_optimiser, build_problem
from pipelines.overrides import as_hydra_reads


def test_a_command_is_composed_without_being_run():
    cfg = pipelines.compose("optimise", "+experiment=debug", "optimiser=ega", "deployment.count=20")
    problem = build_problem(cfg)
    assert (problem.count, cfg.objective.thold_p) == (20, 0.3)
    assert build_optimiser(cfg, cfg.seed).population_size == 30
    with pytest.raises(HydraException, match="Could not find 'optimiser/egg'"):
        pipelines.compose("optimise", "optimiser=egg")


def test_a_frozen_problem_is_composed_as_on_the_command_line():
    problem = build_problem(pipelines.compose("optimise", "suite=tiny_mean"))
    box = lmd.suite.problem("tiny_mean")
    assert problem.fitness_of(box.deployment(box.start())) == box(box.start())
    with pytest.raises(InputError, match="suite=tiny_mean has a frozen problem: leave room out"):
        pipelines.compose("optimise", "suite=tiny_mean", "room=lab")


def test_the_folder_of_configurations_is_a_module_for_hydra():
    with initialize_config_module("conf", version_base="1.3"):
        assert compose("optimise", ["experiment=debug"]).deployment.count == 30


def test_a_plus_before_an_experiment_does_no_harm():
    assert as_hydra_reads("+experiment=debug") == "experiment=debug"
    assert as_hydra_reads("+room.note=a") == "+room.note=a"


def test_the_page_on_running_shows_how_from_python():
    page = Path(__file__).parents[2] / "docs" / "running.md"
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    names: dict = {}
    exec("".join(blocks), names)
    assert names["result"].fitness > 0.3
    assert len(names["deployment"]) == names["problem"].count
    assert names["problem"].fitness_of(names["deployment"]) == names["fitness"].max()
