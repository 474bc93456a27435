"""Acceptance of a hung map: predicted shifts against OpenCV's PnP, rates against simulation; some 6 seconds."""

import re
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import block_diag
from scipy.special import chndtrinc
from scipy.stats import binom, ncx2
from support.composing import composed
from support.processes import inside

from lmd.core.checks import InputError
from lmd.evaluation.acceptance import PLACE, REPORTED, Acceptance, HungMap
from lmd.evaluation.mounting import MountingError
from lmd.evaluation.uncertainty import UncertaintyStudy
from lmd.geometry.pose import body_from_corners
from lmd.geometry.projection import project
from lmd.geometry.se3 import camera_pose
from lmd.geometry.squares import corners
from pipelines.building import build_problem

PAGE = Path(__file__).parents[2] / "docs" / "acceptance.md"
ROW = "station,zone,x,y,z,yaw_deg,reported_x,reported_y,reported_z,tags\n1,hall,{}\n"
REFUSED = [
    ("2,2,1.4,60,2,2,,0 1", "line 2: reported_z is '', not a number"),
    ("2,2,1.4,60,2,2,1.4,", r"station '1' at \[2.0, 2.0, 1.4, 60.0\] sees fewer than 2 listed tags"),
    ("2000,2000,1400,60,2,2,1.4,0 1", r"at \[2000.0, .*\] is outside the room; give metres"),
    ("2,2,1.4,sixty,2,2,1.4,0 1", "yaw_deg is 'sixty', not a number"),
    ("2,2,1.4,60,2,2,inf,0 1", "reported_z is 'inf', not a finite number"),
    ("2,2,1.4,60,2,2,1.4", "has 9 values, but the header has 10 columns"),
]


@pytest.fixture(scope="module")
def hung():
    problem = build_problem(composed("evaluate", "experiment=lab", "deployment=uniform"))
    tags = problem.draw(np.random.default_rng(0))
    errors, _ = UncertaintyStudy(corners="objective").errors(problem, tags, 0)
    spread = block_diag(*MountingError(0.002).covariances(problem, tags))
    return HungMap(problem, tags, errors, spread, Acceptance(headings=8, shift=0.03))


@pytest.fixture(scope="module")
def plan(hung):
    return hung.chosen(0)


def measured(hung, stations, rng, moved=None):
    """Table of stations measured in a right map, or in one whose tag `moved` hangs 3 cm up of its place."""
    read = np.array([np.isin(hung.tags.ids.astype(str), text.split()) for text in stations["tags"]])
    _, slopes, noise, *_ = hung.views(stations[PLACE].to_numpy(), read)
    errors = rng.multivariate_normal(np.zeros(len(hung.spread)), hung.spread)
    errors += 0.0 if moved is None else hung.settings.shift * hung.along[:, 2 * moved + 1]
    off = slopes @ errors + [rng.multivariate_normal(np.zeros(3), own) for own in noise]
    return stations.assign(**dict(zip(REPORTED, (stations[PLACE[:3]].to_numpy() + off).T, strict=True)))


def judged(hung, table, folder):
    table.to_csv(folder / "filled.csv", index=False)
    return hung.judged(str(folder / "filled.csv"))


def test_few_stations_show_every_tag_and_none_is_idle(hung, plan):
    stations, tags = plan
    assert len(stations) < len(tags)
    assert tags.least_shift.max() <= 0.03
    assert ncx2.sf(hung.limit, 2, chndtrinc(hung.limit, 2, 0.05)) == pytest.approx(0.95)
    shown, slopes, noise, _, bounds = hung.views(stations[PLACE].to_numpy())
    assert [" ".join(map(str, hung.tags.ids[own])) for own in shown] == stations["tags"].tolist()
    assert bounds[0].max() <= hung.settings.mean
    assert hung._reached(hung._tested(slopes[:-1], noise[:-1])[0]).min() < 1.0


def test_a_shifted_tag_pulls_the_pose_as_predicted(hung, plan):
    """OpenCV's PnP, in images without noise, of tags of which one hangs 2 mm off."""
    at, tags, (camera,) = plan[0][PLACE].to_numpy(), hung.tags, hung.problem.scene.cameras
    poses, (shown, slopes, *_) = camera_pose(at[:, :3], np.radians(at[:, 3]), 0.0), hung.views(at)
    points, step = corners(tags.places, tags.normals, tags.ups, tags.edges_of(hung.problem.scene.tag)), 2e-3
    for s in range(0, len(at), 3):
        k = int(np.flatnonzero(shown[s])[0])
        for column in (2 * k, 2 * k + 1):
            way = hung.along[6 * k : 6 * k + 3, column]
            hanging = points + step * way * (np.arange(len(tags)) == k)[:, None, None]
            image = project(camera, poses[s : s + 1], hanging[shown[s]].reshape(-1, 3))
            found = body_from_corners([camera], np.eye(4)[None], points[shown[s]], [image])[:3, 3] - at[s, :3]
            np.testing.assert_allclose(found / step, slopes[s] @ hung.along[:, column], rtol=0.02, atol=0.02)


def test_bounds_hold_95_percent_of_errors(hung, plan):
    _, _, _, right, bounds = hung.views(plan[0][PLACE].to_numpy())
    drawn = np.random.default_rng(0).normal(size=(len(right), 20000, 3)) @ np.swapaxes(np.linalg.cholesky(right), 1, 2)
    assert np.abs((np.linalg.norm(drawn, axis=2) <= bounds[0][:, None]).mean(axis=1) - 0.95).max() < 0.01


def test_a_tag_that_hangs_wrongly_is_named_and_none_in_a_right_map(hung, plan, tmp_path):
    _, figures, text = judged(hung, measured(hung, plan[0], np.random.default_rng(1)), tmp_path)
    assert (figures["passed"], figures["tags_named"], text) == (1.0, 0.0, "passed; false alarms of the tests: 0.01")
    files, figures, text = judged(hung, measured(hung, plan[0], np.random.default_rng(1), moved=5), tmp_path)
    assert figures["passed"] == 0.0
    tags = files["acceptance_tags.csv"].set_index("id")
    assert tags.index[tags.named].tolist() == [5]
    assert tags.up[5] == pytest.approx(0.03, abs=0.012)
    assert "tag 5 explains this" in text
    far = measured(hung, plan[0], np.random.default_rng(1))
    far.loc[0, "reported_x"] += 0.2
    files, figures, text = judged(hung, far, tmp_path)
    assert files["acceptance.csv"].station[~files["acceptance.csv"].passed].tolist() == ["1"]
    assert f"zone {far.zone[0]} fails" in text


@pytest.mark.thorough("lmd/evaluation/acceptance.py", "lmd/estimation/pose_covariance.py")
def test_rates_are_as_stated(hung, plan, tmp_path):
    """Some 20 seconds; `moved` is shifted up, where tags are seen better than in their worst direction."""
    rng, count = np.random.default_rng(2), 60
    alarms = sum(judged(hung, measured(hung, plan[0], rng), tmp_path)[1]["passed"] == 0.0 for _ in range(count))
    assert alarms <= binom.ppf(0.999, count, 0.01)
    moved = rng.integers(len(hung.tags), size=count)
    found = [judged(hung, measured(hung, plan[0], rng, k), tmp_path)[0]["acceptance_tags.csv"].named[k] for k in moved]
    assert np.mean(found) >= 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / count)


@pytest.mark.parametrize(("row", "sentence"), REFUSED)
def test_a_faulty_table_gets_one_sentence(hung, write, row, sentence):
    with pytest.raises(InputError, match=sentence):
        hung.judged(write(ROW.format(row)))
    with pytest.raises(InputError, match=r"lacks the column 'zone', which stations.csv has"):
        hung.judged(write(ROW.format("2,2,1.4,60,2,2,1.4,0 1").replace("zone", "area")))


@pytest.mark.thorough("docs/acceptance.md", "pipelines/studies.py", "lmd/evaluation/acceptance.py", "lmd/export")
def test_the_commands_of_the_page_run(tmp_path):
    made = "experiment=lab", "deployment=uniform", "losses=false", "localisation=false", "hydra.run.dir=outputs/lab"
    assert inside("evaluate", *made, "tracking=none", cwd=tmp_path, settings=()).returncode == 0
    lines = re.search(r"```sh\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)[1].replace("\\\n", "").splitlines()
    for line in lines:
        _, _, module, *overrides = shlex.split(line, comments=True)
        done = inside(module.removeprefix("pipelines."), *overrides, "tracking=none", cwd=tmp_path, settings=())
        assert done.returncode == 0, done.stderr
        if (table := tmp_path / "outputs/stations/stations.csv").exists():
            stations = pd.read_csv(table, dtype={"tags": str})
            filled = stations.assign(**{name: stations[name[-1]] for name in REPORTED})
            filled.to_csv(tmp_path / "filled.csv", index=False)
    assert "passed" in done.stdout
