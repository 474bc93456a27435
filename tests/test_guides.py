"""The folder `examples` and docs/extend.md: examples are in style, have types, keep their contracts, and run."""

import importlib.util
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tomllib
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
import yaml
from contracts.criterion import check_counts, check_criterion, check_members, check_slack, tilted
from contracts.estimator import check_estimator
from contracts.format import check_format
from contracts.objective import check_objective
from contracts.optimiser import check_optimiser
from contracts.space import check_space
from support import composing
from support.paper import paper_camera, paper_room, paper_scene
from support.processes import call
from support.small import problem

from lmd.core.checks import InputError
from lmd.evaluation.bounds import Search, average_upper_bound
from lmd.evaluation.losses import losses
from lmd.export import exports
from lmd.formats import registry
from lmd.formats.calibrations import read_calibration
from lmd.formats.tag_map import TagMap
from lmd.geometry.vectors import dot3
from lmd.objectives.localisation import Localisation
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.genetic import EGA
from lmd.optimisers.greedy import Greedy
from lmd.optimisers.ledger import Budget
from lmd.problem import Problem
from lmd.scene import pdf
from lmd.scene.criteria import from_position, hide, in_image, in_view
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import evaluate_range
from lmd.sight.models.fiducial import Fiducial
from pipelines.building import build_optimiser, build_problem

pytestmark = [pytest.mark.slow, pytest.mark.long]  # what is made for classes from elsewhere is compiled anew each time

ROOT = Path(__file__).parents[1]
GUIDE = (ROOT / "docs" / "extend.md").read_text(encoding="utf-8")
EXAMPLES = ROOT / "examples"
COMPILED = "examples", "lmd/incremental", "lmd/scene/criteria.py", "lmd/sight", "tests/contracts"
BLOCKS = re.findall(r"```(?:python|toml)\n(.*?)```", GUIDE, re.DOTALL)
MODULES = sorted(path.name for path in EXAMPLES.glob("*.py"))


def block(start):
    (text,) = (text for text in BLOCKS if text.lstrip().startswith(start))
    return text


@pytest.fixture(scope="module")
def guides(tmp_path_factory):
    """A copy of the folder of the examples, on the import path of Python."""
    folder = tmp_path_factory.mktemp("guides") / "examples"
    shutil.copytree(EXAMPLES, folder, ignore=shutil.ignore_patterns("__pycache__", "outputs"))
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        yield folder


def of(name):
    return importlib.import_module(name)


def test_the_guide_shows_every_example():
    shown = set(re.findall(r'--8<-- "examples/(.*)"', GUIDE))
    assert {name for name in shown if name.endswith(".py")} == {*MODULES} - {"tune.py"}
    assert all((EXAMPLES / name).exists() for name in shown)
    assert '--8<-- "examples/tune.py"' in (ROOT / "docs" / "servers.md").read_text(encoding="utf-8")


@pytest.mark.thorough("examples", "lmd", "pipelines", "pyproject.toml")
def test_the_examples_have_types(guides):
    """10 s of processor time where mypy has not read `lmd` before."""
    cache = ["--cache-dir", str(ROOT / ".mypy_cache"), "--config-file", str(ROOT / "pyproject.toml")]
    check([sys.executable, "-m", "mypy", *cache, "--explicit-package-bases", *MODULES], guides)


def check(line, folder):
    path = os.pathsep.join(map(str, (folder, ROOT)))
    environment = os.environ | {"PYTHONPATH": path, "MYPYPATH": str(ROOT)}
    done = subprocess.run(line, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def composed(guides, *overrides, app="optimise"):
    return composing.composed(app, f"hydra.searchpath=[file://{guides}/mine]", *overrides)


def compiled_near(reach=3.0):
    return of("near_sight").CompiledNear(reach)


def near_scene(criteria=None):
    return Scene(paper_room(spacing=1.5), paper_camera(), pdf.grid_with_ends(6), criteria or compiled_near())


def test_the_criterion_keeps_its_contract(guides):
    exec(block("from contracts.criterion"), {})


def test_the_compiled_criterion_counts_what_its_reference_does(guides):
    scene, rng = near_scene(), np.random.default_rng(0)
    check_members(compiled_near(), paper_camera(), rng)
    check_counts(scene, RandomDeployment(24).draw(scene.room, rng), 2)


@pytest.mark.thorough(*COMPILED)
def test_the_compiled_criterion_keeps_its_contract(guides):
    """Moves, and two cameras on one body, take 40 s to compile."""
    check_criterion(compiled_near(), paper_camera())


def test_a_criterion_that_ignores_slack_is_found_out(guides):
    near, scene = of("near_sight"), near_scene()
    cosine = near.COSINE

    class CarelessSight(near.NearSight):
        """Answers for the middle of a piece of wall only."""

    class Careless(near.CompiledNear):
        def sight(self, camera):
            return CarelessSight(self.range)

    @from_position.register(CarelessSight)
    def _from_position(sight, offset, normal, slack):
        distance = math.sqrt(dot3(offset, offset))
        return (distance <= sight.range) & (dot3(normal, offset) < 0.0), cosine * distance, math.inf, -math.inf

    for function, body in ((in_image, near._in_image), (in_view, near._in_view), (hide, near._hide)):
        function.register(CarelessSight)(body)
    check_slack(scene, 1.0, np.random.default_rng(0))
    with pytest.raises(AssertionError, match="a landmark gains more than its cell"):
        check_slack(replace(scene, visibility=Careless(3.0)), 1.0, np.random.default_rng(0))


def test_what_is_compiled_for_a_class_from_elsewhere_does_not_spoil_the_cache_for_others(guides):
    def named():
        files = Path(evaluate_range._cache._cache_file._index_path).parent.glob("kernels.evaluate_range-*.nbi")
        return {path.name for path in files if b"NearSight" in path.read_bytes()}

    scene, before = near_scene(), named()  # other versions of the code may have compiled the class too
    Evaluator(scene, threads=1).counts(RandomDeployment(3).draw(scene.room, np.random.default_rng(0)))
    assert any("NearSight" in str(signature) for signature in evaluate_range.signatures)
    own = {evaluate_range._cache._cache_file._index_name}
    assert own <= named() <= own | before


def test_the_objective_keeps_its_contract(guides):
    check_objective(of("seen").MeanSeen(2, 0.5), paper_scene(paper_room(spacing=2.0), None, pdf.grid_with_ends(6)))


def test_the_space_keeps_its_contract(guides):
    check_space(of("rotunda").Rotunda((6.0, 5.0, 3.0), (5.0, 4.0, 2.0), 1.0))


@pytest.mark.parametrize("name", ["climbing.HillClimber", "theirs.Theirs"])
def test_the_optimisers_keep_their_contract(guides, tmp_path, name):
    module, kind = name.split(".")
    check_optimiser(getattr(of(module), kind), problem, tmp_path)


def test_optuna_searches_parameters_of_an_optimiser(guides):
    found = of("tune").tuned(trials=3, evaluations=60)
    assert len(found.trials) == 3
    assert 0.0 < found.best_value < 0.4


def test_the_estimator_keeps_its_contract(guides):
    check_estimator(of("reckoning").DeadReckoning())


@pytest.fixture
def packages(guides, monkeypatch):
    """The entry points of the examples of formats."""
    points = tomllib.loads(block("[project.entry-points"))["project"]["entry-points"][registry.GROUP]
    entries = [EntryPoint(name, value, registry.GROUP) for name, value in points.items()]
    monkeypatch.setattr(registry, "entry_points", lambda group: entries if group == registry.GROUP else [])
    monkeypatch.setattr(registry, "outside", registry.outside.__wrapped__)


@pytest.mark.usefixtures("packages")
def test_the_format_keeps_its_contract(tmp_path):
    room, rng = paper_room(), np.random.default_rng(0)
    tags = TagMap(room, Tag(0.2), tilted(RandomDeployment(5).draw(room, rng), rng))
    check_format(exports.all_formats()["frames"], tags, tmp_path)


def test_the_row_of_a_format_is_found_on_the_search_path(guides, monkeypatch):
    keys = {"kind": "brown", "f": [600.0, 610.0], "c": [320, 240], "k": [-0.2, 0.05, 0.001, -0.002]}
    (guides / "acme.json").write_text(json.dumps({"acme": {"pixels": [640, 480], "lens": keys}}))
    line = next(line for line in GUIDE.splitlines() if "camera.path=acme.json" in line)
    more = "room=lab deployment=uniform deployment.count=3 localisation=false losses=false tracking=none room.spacing=2"
    assert "field of view" in check(["bash", "-c", f"{line} {more}".replace("python", sys.executable)], guides)
    monkeypatch.setenv("LMD_FORMATS", str(guides / "mine" / "file_formats"))
    monkeypatch.setattr(registry, "outside", registry.outside.__wrapped__)
    found = read_calibration(guides / "acme.json")
    assert (found.focal_pixels, found.distortion[:4]) == ((600.0, 610.0), (-0.2, 0.05, 0.001, -0.002))


def test_the_study_is_one_short_file(guides):
    assert len((EXAMPLES / "darkness.py").read_text().splitlines()) <= 60
    settings = ["room.spacing=1.5", "deployment=random", "tracking=none", "darkness.level=0.3", "hydra.run.dir=dark"]
    told = check([sys.executable, "darkness.py", *settings], guides)
    assert re.search(r"^dark +\d+\.\d% of the positions see less than 0\.3$", told, re.MULTILINE)
    assert {path.name for path in (guides / "dark").iterdir()} == {".hydra", "darkness.csv", "darkness.json"}


@pytest.mark.parametrize(
    ("visibility", "kind"),
    [("near", "Near"), pytest.param("compiled_near", "CompiledNear", marks=pytest.mark.thorough(*COMPILED))],
)
def test_the_parts_are_choices_on_the_command_line(guides, visibility, kind):
    parts = f"visibility={visibility}", "objective=seen", "room=rotunda"
    chosen, names = (*parts, "room.spacing=2", "pdf.divisions=6", "threads=1"), []
    for optimiser in ("hill", "annealing"):
        cfg = composed(guides, *chosen, f"optimiser={optimiser}", "deployment.count=10")
        p, method = build_problem(cfg), build_optimiser(cfg, 0)
        result = method.run(p, Budget(100))
        assert result.fitness > result.history[0].best_fitness
        names.append(type(method).__name__)
    assert names == ["HillClimber", "Annealing"]
    chosen = p.scene.visibility, p.objective, p.scene.room
    assert [type(part).__name__ for part in chosen] == [kind, "MeanSeen", "Rotunda"]
    text = yaml.safe_load((EXAMPLES / "mine/estimator/reckoning.yaml").read_text())
    assert text["reckoning"]["_target_"] == "reckoning.DeadReckoning"
    both = composed(guides, "studies=[observe]", "estimator=[reckoning,iekf]", app="evaluate").estimator
    assert list(both) == ["reckoning", "iekf"]


class Unselected(Localisation):
    """An objective whose field has no stacks, and without a selection."""

    selection = None


class Bare:
    """An objective with no more than it must have: the values of another."""

    def __init__(self, whole):
        self._whole = whole

    def __getattr__(self, name):
        if name in ("field", "target", "selection"):
            raise AttributeError(name)
        return getattr(self._whole, name)


@pytest.mark.thorough("examples", "lmd/optimisers", "lmd/objectives")
def test_annealing_does_without_stacks_and_selection_and_greedy_says_what_it_lacks():
    p = problem(tag=Tag(0.2))
    scene = replace(p.scene, visibility=Fiducial(Tag(0.2)))  # compiled for tags, as commands are
    p = Problem(scene, Unselected(tolerance=0.1), p.start, threads=1)
    result = Annealing().run(p, Budget(100))
    assert result.fitness > result.history[0].best_fitness
    greedy = Greedy()
    with pytest.raises(InputError, match=r"^Unselected has no `selection`, which greedy choices need\.$"):
        greedy.run(p, Budget(100))
    assert not greedy.ledger.history


def test_a_black_box_climbs_what_has_values_only_and_the_rest_says_what_it_lacks():
    p = problem()
    p = Problem(p.scene, Bare(p.objective), p.start, threads=1)
    result = EGA().run(p, Budget(200))
    assert result.fitness > result.history[0].best_fitness
    for method in (Annealing(), Greedy()):
        with pytest.raises(InputError, match=r"^Bare cannot evaluate moves"):
            method.run(p, Budget(50))
        assert not method.ledger.history
    with pytest.raises(InputError, match="Bare cannot evaluate moves"):
        losses(p, result.deployment)
    with pytest.raises(InputError, match=r"no upper bound for the objective Bare"):
        average_upper_bound(p, 20, Search(1.0, 10, 0.1))


def test_a_command_refuses_what_does_not_fit_before_it_writes_anything(guides, tmp_path):
    (tmp_path / "bare.py").write_text("from seen import MeanSeen\n\n\nclass Bare(MeanSeen):\n    field = None\n")
    (tmp_path / "objective").mkdir()
    (tmp_path / "objective/bare.yaml").write_text("_target_: bare.Bare\nn: 1\nthold_p: 0.5\n")
    settings = [f"hydra.searchpath=[file://{tmp_path}]", "objective=bare", "hydra.run.dir=run"]
    done = call("optimise", cwd=tmp_path, settings=settings, folders=[tmp_path, guides])
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("error: Bare cannot evaluate moves of single landmarks; use a black-box optimiser")
    assert not (tmp_path / "outputs").exists()
    assert not list((tmp_path / "run").glob("*.*"))
