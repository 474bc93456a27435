"""Uncertainty of the pose from one image: tables, laws and their code; some 10 seconds."""

import numpy as np
import pytest
from support.composing import composed
from support.tables import rows

from lmd.core.checks import InputError
from lmd.estimation.deviation_law import LEAST_VIEWS, QUANTITIES, PowerLaw, fit_law, fit_rule, ratio_quantiles
from lmd.evaluation.mounting import MountingError
from lmd.evaluation.uncertainty import SDS, UncertaintyStudy, level_deviations, uncertainty
from lmd.evaluation.uncertainty_law import per_axis, uncertainty_law
from lmd.objectives.localisation.ambiguity import CONFIDENCE
from pipelines.building import build_problem

STUDY = UncertaintyStudy(corners="apriltag", shift=0.0, views=3000)


@pytest.fixture(scope="module")
def lab():
    problem = build_problem(composed("evaluate", "experiment=lab", "deployment=uniform"))
    return problem, problem.draw(np.random.default_rng(0))


@pytest.fixture(scope="module")
def found(lab):
    return uncertainty(*lab, STUDY, 0)


def test_every_view_has_a_row_and_a_kind(found):
    views = found.views
    assert len(views) == 3000
    assert (views.pose == "none").equals(views.tags == 0)
    assert views.loc[views.pose == "none", ["distance", *SDS]].isna().all(axis=None)
    assert views.loc[views.pose != "none", ["distance", *SDS]].gt(0.0).all(axis=None)
    assert views.mirrored.notna().equals(views.tags == 1)
    assert (views.pose == "two").equals(views.mirrored > 1.0 - CONFIDENCE)
    assert set(views.pose) == {"one", "two", "none"}
    shares = [found.metrics()[f"share_{kind}"] for kind in ("one", "two", "none")]
    assert sum(shares) == pytest.approx(1.0)


def test_deviations_are_those_of_the_covariances(found):
    some = np.flatnonzero(found.views.pose == "one")[:20]
    for v in some:
        row, covariance = found.views.loc[v], found.covariances[v]
        assert row.sd_x == pytest.approx(np.sqrt(covariance[0, 0]))
        assert row.sd_yaw == pytest.approx(np.sqrt(covariance[5, 5]))
        tilt = row.sd_roll**2 + row.sd_pitch**2
        assert tilt == pytest.approx(covariance[3, 3] + covariance[4, 4])


def test_roll_is_about_the_heading():
    covariance = np.diag([1.0, 4.0, 9.0, 16.0, 25.0, 36.0])[None]
    north, east = (level_deviations(covariance, np.array([yaw]))[0] for yaw in (0.0, np.pi / 2.0))
    assert np.allclose(north, [1, 2, 3, 5, 4, 6])  # y is ahead
    assert np.allclose(east, [1, 2, 3, 4, 5, 6])


def test_a_mounting_error_is_a_covariance(lab):
    problem, deployment = lab
    found = MountingError(0.01, 0.02, 0.03, 1).covariances(problem, deployment)
    for covariance, normal in zip(found, deployment.normals, strict=True):
        assert normal @ covariance[:3, :3] @ normal == pytest.approx(0.0, abs=1e-18)
        assert np.trace(covariance[:3, :3]) == pytest.approx(2 * 0.01**2)
        assert normal @ covariance[3:, 3:] @ normal == pytest.approx(0.02**2)
        assert np.trace(covariance[3:, 3:]) == pytest.approx(0.02**2 + 2 * 0.03**2)


@pytest.mark.parametrize(("settings", "reader", "shift"), rows(__file__, "corner errors"))
def test_corner_errors_come_from_the_detector_of_the_scene(lab, settings, reader, shift):
    """Of 30 images ArUco's errors are measured: it finds tags too small by a quarter of a pixel on each side."""
    errors, about = UncertaintyStudy(**settings).errors(*lab, 0)
    assert about.startswith(reader)
    assert errors.shift == shift
    if settings == {"frames": 30}:
        sigma, inward = errors.at(np.array([2.5]), np.array([0.6]))
        assert 0.1 < sigma[0] < 0.5
        assert 0.15 < inward[0] < 0.4
        assert np.trace(errors.modes) == pytest.approx(8.0)
        with pytest.raises(InputError, match=r"frames: \d+ tags were detected, but 40 are needed"):
            UncertaintyStudy(corners="rendered", frames=5).errors(*lab, 0)


def test_power_laws_are_recovered():
    rng = np.random.default_rng(0)
    distance, tags = rng.uniform(1.0, 6.0, 500), rng.integers(1, 6, 500)
    one, several = PowerLaw(0.02, 2.2), PowerLaw(0.03, 1.7, 0.8)
    deviation = np.where(tags == 1, one.at(distance, 1), several.at(distance, tags))
    law = fit_law(distance, tags, deviation)
    for found, true in ((law.one, one), (law.several, several)):
        assert [found.scale, found.distance, found.tags] == pytest.approx([true.scale, true.distance, true.tags])
    assert ratio_quantiles(deviation, law.at(distance, tags))["factor_90"] == pytest.approx(1.0)
    few = np.ones(LEAST_VIEWS - 1)
    with pytest.raises(InputError, match=f"only {LEAST_VIEWS - 1} of the random views determine one pose"):
        fit_law(few, few.astype(int), few)
    rule = fit_rule("squared", distance, tags, 0.05 * distance**2 / tags)
    assert (rule.one, rule.several) == pytest.approx((0.05, 0.05))


def test_errors_normalised_by_the_law_have_mean_square_one(found):
    law = uncertainty_law(found)
    some = found.views[found.views.pose == "one"]
    where = some.distance.to_numpy(), some.tags.to_numpy()
    for name, deviation in per_axis(some).items():
        for number in (where[1] == 1, where[1] > 1):
            ratio = deviation[number] / law.laws[name].at(*where)[number]
            assert (ratio**2).mean() == pytest.approx(1.0)
    errors = law.errors.set_index(["quantity", "rule"]).factor_90
    assert all(errors[name, "law"] < errors[name, "constant"] for name in QUANTITIES)
    assert law.table.views.sum() == (found.views.pose != "none").sum()
    assert law.table.loc[law.table.tags != "1", "two_poses"].eq(0.0).all()
