"""The paper's Monte Carlo procedure, from a recording to an orientation PDF."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm, vonmises
from support.recordings import MOVING, estimated, independent_draws, simulated

from lmd.core.checks import InputError
from lmd.orientation import density
from lmd.orientation.density import AngleCells, circular_difference
from lmd.orientation.recording import FileRecording, OrientationRecording
from lmd.scene import pdf

STEP = np.pi / 12


def at_cells(orientations, shift=0):
    """Weights by cell of the orientation grid, the yaw turned back by `shift` steps."""
    cells = zip(np.rint(orientations.yaw / STEP) - shift, np.floor(orientations.pitch / STEP), strict=True)
    return {(int(a) % 24, int(b)): weight for (a, b), weight in zip(cells, orientations.weight, strict=True)}


@pytest.mark.parametrize("coupling", [0.0, 0.7])
def test_a_yaw_across_the_seam_gives_the_pdf_of_the_same_yaw_elsewhere(coupling):
    across = simulated(**MOVING, coupling=coupling)
    assert across.yaw.min() < -3.1
    assert across.yaw.max() > 3.1
    turned = OrientationRecording(across.time, circular_difference(across.yaw, 12 * STEP), across.pitch)
    here, there = estimated(across), estimated(turned)
    assert here.form == there.form == ("joint" if coupling else "product")
    weights = at_cells(there.pdf)
    assert weights.keys() == at_cells(here.pdf, shift=12).keys()
    for cell, weight in at_cells(here.pdf, shift=12).items():
        assert weights[cell] == pytest.approx(weight, abs=1e-9)


def test_a_fixed_pitch_gives_a_pdf_in_yaw_alone():
    result = estimated(simulated())
    assert result.independence is None
    assert_allclose(result.pdf.pitch, -0.1)
    level = pdf.level_flight(12, -0.1)
    assert result.yaw.density.family == "uniform"
    assert_allclose(result.pdf.yaw, level.yaw, atol=1e-12)
    assert_allclose(result.pdf.weight, level.weight, atol=1e-12)


def test_a_fixed_camera_gives_a_single_orientation():
    time = np.arange(200.0)
    turned = estimated(OrientationRecording(time, np.where(time % 2, np.pi, -np.pi), np.full(200, 0.3)))
    assert len(turned.pdf.weight) == 1
    assert abs(circular_difference(turned.pdf.yaw[0], np.pi)) < 1e-9
    assert turned.pdf.pitch[0] == pytest.approx(0.3)


def test_a_single_record_of_another_pitch_is_no_obstacle():
    rng = np.random.default_rng(0)
    pitch = np.zeros(300)
    pitch[150] = 0.5
    result = estimated(independent_draws(rng.uniform(-np.pi, np.pi, 300), pitch), mean_interval=1.0)
    assert np.isfinite(result.pdf.weight).all()
    assert abs(result.pdf.weight @ result.pdf.pitch) < 0.02


def test_too_few_samples_are_refused_with_their_number_and_the_file(tmp_path):
    path = tmp_path / "flight.csv"
    simulated(duration=120.0).to_csv(path)
    with pytest.raises(
        InputError, match=r"flight\.csv: 120 s at a mean interval of \d\.\d+ s give \d\d samples, fewer"
    ):
        estimated(FileRecording(str(path)).record(np.random.default_rng(0)))


def test_the_known_distribution_of_a_simulated_recording_is_recovered():
    result = estimated(simulated(duration=6000.0, **MOVING), significance=0.001)
    yaw, pitch = result.yaw.density, result.pitch.density
    assert (yaw.family, pitch.family) == ("von_mises", "normal")
    assert abs(circular_difference(yaw.parameters["mean"], 3.0)) < 0.1
    assert yaw.parameters["concentration"] == pytest.approx(2.0, rel=0.15)
    assert pitch.parameters["mean"] == pytest.approx(-0.1, abs=0.02)
    assert pitch.parameters["standard_deviation"] == pytest.approx(0.2, rel=0.1)
    # ... and the PDF is that distribution, cell by cell: half the total variation distance to it is small.
    truth = {
        (a, b): np.diff(vonmises.cdf([(a - 0.5) * STEP, (a + 0.5) * STEP], 2.0, loc=3.0))[0]
        * np.diff(norm.cdf([b * STEP, (b + 1) * STEP], -0.1, 0.2))[0]
        for a in range(24)
        for b in range(-6, 6)
    }
    found = at_cells(result.pdf)
    assert sum(abs(truth[cell] - found.get(cell, 0.0)) for cell in truth) / 2.0 < 0.05


def test_four_walls_looked_at_in_turn_need_a_kernel_estimate():
    rng = np.random.default_rng(0)
    yaw = circular_difference(rng.integers(4, size=1500) * np.pi / 2 + rng.normal(0.0, 0.2, 1500), 0.0)
    result = estimated(independent_draws(yaw, np.zeros(1500)), mean_interval=2.0)
    assert result.yaw.density.family == "kernel"
    weight = dict(zip(np.rint(result.pdf.yaw / STEP).astype(int) % 24, result.pdf.weight, strict=True))
    assert min(weight[a] for a in (0, 6, 12, 18)) > 8.0 * max(weight.get(a, 0.0) for a in (3, 9, 15, 21))


def test_the_simplest_family_within_one_standard_error_of_the_best_is_chosen():
    result = estimated(simulated(seed=3, **MOVING))
    for marginal in (result.yaw, result.pitch):
        within = [c.density.family for c in marginal.candidates if c.behind <= c.standard_error]
        assert marginal.density.family == within[0]
        assert min(c.behind for c in marginal.candidates) == 0.0
        best = max(c.log_likelihood for c in marginal.candidates)
        assert_allclose([c.behind for c in marginal.candidates], [best - c.log_likelihood for c in marginal.candidates])


@pytest.mark.parametrize("circular", [True, False])
def test_every_family_is_a_density_and_a_kernel_wraps_only_around_a_circle(circular):
    axis = AngleCells(-np.pi, np.pi, 96, circular) if circular else AngleCells(-np.pi / 2, np.pi / 2, 96, circular)
    angle = np.full(60, axis.high - 1e-3)
    for family in (density.uniform, density.von_mises if circular else density.normal, density.kernel_estimate):
        assert family(angle, axis).probability.sum() == pytest.approx(1.0)
    probability = density.kernel_estimate(angle, axis).probability
    assert (probability[0] > 0.1) == circular
    assert (probability[-1] > 0.4) != circular


def test_a_pitch_that_hardly_moves_keeps_its_mean_and_spread_on_a_coarse_grid():
    result = estimated(simulated(duration=6000.0, pitch_mean=0.02, pitch_std=0.05))
    mean = result.pdf.weight @ result.pdf.pitch
    assert mean == pytest.approx(0.02, abs=0.01)
    assert np.sqrt(result.pdf.weight @ (result.pdf.pitch - mean) ** 2) == pytest.approx(
        0.05 * np.sqrt(2 / np.pi), rel=0.2
    )
