"""The paper's Monte Carlo procedure, from a recording to an orientation PDF, in Python and as a command."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from matplotlib.image import imread
from mlflow import MlflowClient
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from scipy.stats import norm, vonmises

from lmd import pdf
from lmd.checks import InputError
from lmd.frames import rotation
from lmd.orientation import density
from lmd.orientation.density import Axis
from lmd.orientation.estimate import estimate_pdf
from lmd.orientation.recording import FileRecording, OrientationRecording, SimulatedRecording
from lmd.orientation.sampling import (
    Samples,
    circular_difference,
    independence_test,
    integrated_correlation_time,
    sample_at_random_intervals,
)
from pipelines.app import CONF, instantiate

ROOT = Path(__file__).parents[1]
STEP = np.pi / 12
LEVEL = {
    "duration": 1200.0,
    "rate": 10.0,
    "correlation_time": 1.0,
    "yaw_mean": 0.0,
    "yaw_concentration": 0.0,
    "pitch_mean": -0.1,
    "pitch_std": 0.0,
    "coupling": 0.0,
}
MOVING = {"yaw_mean": 3.0, "yaw_concentration": 2.0, "pitch_std": 0.2}


def simulated(seed=0, **changes):
    return SimulatedRecording(**(LEVEL | changes)).record(np.random.default_rng(seed))


def estimated(recording, seed=1, **settings):
    return estimate_pdf(recording, np.random.default_rng(seed), **settings)


def independent_draws(yaw, pitch):
    """A recording whose records, one a second, have nothing to do with each other."""
    return OrientationRecording(np.arange(len(yaw)), yaw, pitch, "draws")


def at_cells(orientations, shift=0):
    """Weights by cell of the orientation grid, the yaw turned back by `shift` steps."""
    cells = zip(np.rint(orientations.yaw / STEP) - shift, np.floor(orientations.pitch / STEP), strict=True)
    return {(int(a) % 24, int(b)): weight for (a, b), weight in zip(cells, orientations.weight, strict=True)}


# The seam, too few samples, a fixed pitch


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


def test_whole_turns_of_the_yaw_change_nothing():
    once = simulated(**MOVING)
    wound = OrientationRecording(once.time, np.unwrap(once.yaw) + 4.0 * np.pi, once.pitch)
    assert_allclose(estimated(wound).pdf.weight, estimated(once).pdf.weight, atol=1e-9)


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


# Sampling


def test_the_correlation_time_is_that_of_the_motion():
    # Of the pitch, the integral of exp(-t^2 / (2 tau^2)); of the slower one where the yaw moves too.
    for tau in (0.5, 1.0, 2.0):
        both = simulated(duration=4000.0, correlation_time=tau, pitch_std=0.1)
        pitch = integrated_correlation_time(OrientationRecording(both.time, np.zeros_like(both.yaw), both.pitch))
        yaw = integrated_correlation_time(OrientationRecording(both.time, both.yaw, np.zeros_like(both.pitch)))
        assert pitch == pytest.approx(np.sqrt(2.0 * np.pi) * tau, rel=0.25)
        assert integrated_correlation_time(both) == max(yaw, pitch)


def test_draws_without_memory_have_the_correlation_time_of_one_step():
    rng = np.random.default_rng(0)
    recording = independent_draws(rng.uniform(-np.pi, np.pi, 5000), rng.normal(0.0, 0.1, 5000))
    assert 1.0 <= integrated_correlation_time(recording) < 1.2


def test_intervals_are_random_with_the_stated_mean_and_never_shorter_than_half_of_it():
    time = np.arange(0.0, 4000.0, 0.01)
    clock = OrientationRecording(time, time, np.zeros_like(time))  # the yaw tells the time
    intervals = np.diff(sample_at_random_intervals(clock, 4.0, np.random.default_rng(0)).yaw)
    assert intervals.min() >= 2.0 - 0.011
    assert intervals.mean() == pytest.approx(4.0, rel=0.05)
    assert intervals.std() == pytest.approx(2.0, rel=0.1)


def test_the_mean_interval_is_twice_the_correlation_time_unless_given():
    recording = simulated(**MOVING)
    samples = sample_at_random_intervals(recording, None, np.random.default_rng(0))
    assert samples.correlation_time == integrated_correlation_time(recording)
    assert samples.mean_interval == 2.0 * samples.correlation_time


def test_a_steady_turn_is_sampled_all_around():
    # A fixed interval of one turn would see a single yaw.
    time = np.arange(0.0, 2000.0, 0.05)
    recording = OrientationRecording(time, circular_difference(time, 0.0), np.zeros_like(time))
    result = estimated(recording, mean_interval=2.0 * np.pi)
    assert result.yaw.density.family == "uniform"


def test_records_count_for_as_long_as_they_hold():
    # Three quarters of the records are made in a quarter of the time.
    time = np.concatenate([np.arange(0.0, 250.0, 1.0 / 9.0), np.arange(250.0, 1000.0)])
    yaw = np.where(time < 250.0, 1.0, -1.0)
    samples = sample_at_random_intervals(OrientationRecording(time, yaw, 0.0 * time), 1.0, np.random.default_rng(0))
    assert np.mean(samples.yaw == 1.0) == pytest.approx(0.25, abs=0.02)


def test_an_interval_below_the_records_own_is_refused():
    with pytest.raises(
        InputError, match=r"mean_interval = 0\.01 s is shorter than the step of the simulated .* 0\.1 s"
    ):
        estimated(simulated(), mean_interval=0.01)


# Independence


def test_independent_angles_are_rejected_as_often_as_the_level_says():
    rng = np.random.default_rng(0)
    p_values = [
        independence_test(Samples(rng.vonmises(3.0, 1.0, 200), rng.normal(0.0, 0.2, 200), 1.0, 2.0), 0.05, rng).p_value
        for _ in range(40)
    ]
    assert 0.3 < np.mean(p_values) < 0.7
    assert np.mean(np.array(p_values) < 0.05) < 0.2


def test_a_dependence_that_no_correlation_shows_is_found():
    rng = np.random.default_rng(0)
    yaw = rng.uniform(-np.pi, np.pi, 400)
    pitch = 0.2 * np.cos(2.0 * yaw) + rng.normal(0.0, 0.2, 400)
    assert independence_test(Samples(yaw, pitch, 1.0, 2.0), 0.05, rng).p_value < 0.001


def test_dependent_angles_get_the_joint_density_and_independent_ones_the_product():
    rng = np.random.default_rng(0)
    yaw = rng.uniform(-np.pi, np.pi, 1500)
    noise = rng.normal(0.0, 0.1, 1500)
    joint = estimated(independent_draws(yaw, 0.6 * np.sin(yaw) + noise), mean_interval=2.0, significance=0.01)
    product = estimated(independent_draws(yaw, noise), mean_interval=2.0, significance=0.01)
    assert (joint.form, product.form) == ("joint", "product")

    def mean_pitch(orientations, toward):
        near = np.abs(circular_difference(orientations.yaw, toward)) < 0.6
        return orientations.weight[near] @ orientations.pitch[near] / orientations.weight[near].sum()

    assert mean_pitch(joint.pdf, np.pi / 2) == pytest.approx(0.57, abs=0.08)
    assert mean_pitch(joint.pdf, -np.pi / 2) == pytest.approx(-0.57, abs=0.08)
    assert mean_pitch(product.pdf, np.pi / 2) == pytest.approx(mean_pitch(product.pdf, -np.pi / 2), abs=1e-6)


def test_the_level_decides():
    recording = simulated(**MOVING, coupling=0.7)
    assert estimated(recording, significance=0.0).form == "product"
    assert estimated(simulated(**MOVING), significance=1.0).form == "joint"


# Fit


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
    axis = Axis(-np.pi, np.pi, 96, circular) if circular else Axis(-np.pi / 2, np.pi / 2, 96, circular)
    angle = np.full(60, axis.high - 1e-3)
    for family in (density.uniform, density.von_mises if circular else density.normal, density.kernel):
        assert family(angle, axis).probability.sum() == pytest.approx(1.0)
    probability = density.kernel(angle, axis).probability
    assert (probability[0] > 0.1) == circular
    assert (probability[-1] > 0.4) != circular


def test_a_pitch_that_hardly_moves_keeps_its_mean_and_spread_on_a_coarse_grid():
    result = estimated(simulated(duration=6000.0, pitch_mean=0.02, pitch_std=0.05))
    mean = result.pdf.weight @ result.pdf.pitch
    assert mean == pytest.approx(0.02, abs=0.01)
    assert np.sqrt(result.pdf.weight @ (result.pdf.pitch - mean) ** 2) == pytest.approx(
        0.05 * np.sqrt(2 / np.pi), rel=0.2
    )


def test_the_step_of_the_grid_is_a_choice():
    result = estimated(simulated(), divisions=36)
    assert_allclose(result.pdf.yaw, pdf.level_flight(36).yaw, atol=1e-12)


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"divisions": 0}, "divisions must be at least 1, got 0"),
        ({"significance": 2.0}, r"significance must be in \[0, 1\], got 2.0"),
        ({"mean_interval": -1.0}, "mean_interval must be greater than 0, got -1.0"),
        ({"mean_interval": "often"}, "mean_interval must be a number, got 'often'"),
    ],
)
def test_bad_settings_are_refused_by_name(settings, named):
    with pytest.raises(InputError, match=named):
        estimated(simulated(), **settings)


# Recordings


def test_a_simulated_recording_is_smooth_also_through_the_seam_and_the_same_for_the_same_seed():
    recording = simulated(rate=100.0, yaw_mean=3.0, yaw_concentration=0.5, pitch_std=0.2)
    assert np.abs(circular_difference(np.diff(recording.yaw), 0.0)).max() < 0.1
    assert np.abs(np.diff(recording.pitch)).max() < 0.02
    assert (np.abs(np.diff(recording.yaw)) > 6.0).any()
    assert (simulated(7).yaw == simulated(7).yaw).all()
    assert (simulated(7).yaw != simulated(8).yaw).any()


def test_a_recording_reads_back_what_it_wrote_and_ignores_positions(write, tmp_path):
    recording = simulated(duration=10.0, **MOVING)
    recording.to_csv(tmp_path / "flight.csv")
    again = OrientationRecording.from_csv(tmp_path / "flight.csv")
    for name in ("time", "yaw", "pitch"):
        assert (getattr(again, name) == getattr(recording, name)).all()
    posed = OrientationRecording.from_csv(write("time,x,y,z,pitch,yaw\n0,1,2,3,0.1,2\n1,1,2,3,0.2,3\n"))
    assert posed.yaw.tolist() == [2.0, 3.0]
    assert posed.pitch.tolist() == [0.1, 0.2]


def test_a_quaternion_is_that_of_the_optical_frame(write):
    yaw, pitch = np.array([0.3, -2.9, 1.0]), np.array([0.2, -1.0, 0.0])
    x, y, z, w = Rotation.from_matrix(np.swapaxes(rotation(yaw, pitch, 0.4), -1, -2)).as_quat().T
    rows = "\n".join(f"{i},{w[i]},{x[i]},{y[i]},{z[i]},1" for i in range(3))
    recording = OrientationRecording.from_csv(write(f"time,qw,qx,qy,qz,x\n{rows}\n"))
    assert_allclose(recording.yaw, yaw, atol=1e-9)
    assert_allclose(recording.pitch, pitch, atol=1e-9)


BAD_RECORDINGS = [
    ("time,yaw,pitch\n0,0,0\n", "has 1 records; a recording needs at least 2"),
    ("time,yaw,pitch\n0,0,0\n2,0,0\n1,0,0\n", "time must increase, but 2 s is followed by 1 s"),
    ("time,yaw,pitch\n0,0,0\n1,0,45\n", "pitch must be in .* radians, got 45"),
    ("time,yaw\n0,0\n", "lacks the column 'pitch'"),
    ("time,yaw,pitch,speed\n0,0,0,1\n", "unknown column 'speed'"),
    ("time,yaw,pitch\n0,nan,0\n", "line 2: yaw is 'nan', not a finite number"),
    ("", "is empty"),
    ("time,qw,qx,qy,qz\n0,1,0,0,0\n1,1,1,0,0\n", "line 3: the quaternion must have length 1, it has 1.41421"),
]


@pytest.mark.parametrize(("text", "named"), BAD_RECORDINGS)
def test_a_bad_recording_is_refused_with_its_name_and_the_value(write, text, named):
    with pytest.raises(InputError, match=rf"flight\.csv.*{named}"):
        OrientationRecording.from_csv(write(text, "flight.csv"))


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"rate": 0.0}, "recording.rate must be greater than 0"),
        ({"duration": 0.1}, "recording.duration must be at least 0.2, got 0.1"),
        ({"pitch_std": -1.0}, "recording.pitch_std must be at least 0, got -1.0"),
        ({"coupling": 1.5}, r"recording.coupling must be in \[-1, 1\], got 1.5"),
    ],
)
def test_a_motion_that_cannot_be_is_refused(changes, named):
    with pytest.raises(InputError, match=named):
        simulated(**changes)


# The command


def call(*overrides, cwd):
    return subprocess.run(
        [sys.executable, "-m", "pipelines.estimate_pdf", "hydra.run.dir=run", *overrides],
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("option", sorted(path.stem for path in Path(CONF, "recording").glob("*.yaml")))
def test_every_kind_of_recording_composes_and_builds(option):
    with initialize_config_dir(CONF, version_base="1.3"):
        instantiate(compose("estimate_pdf", [f"recording={option}"]).recording)


def test_the_command_leaves_a_pdf_that_the_other_pipelines_read(tmp_path):
    simulated(**MOVING).to_csv(tmp_path / "flight.csv")
    done = call("recording.path=flight.csv", "tracking.uri=sqlite:///store.db", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    run = tmp_path / "run"
    assert {path.name for path in run.iterdir()} == {
        ".hydra",
        "estimate_pdf.log",
        "pdf.csv",
        "pdf.png",
        "pdf_estimate.json",
    }
    assert imread(run / "pdf.png").shape[:2] == (500, 1500)
    document = json.loads((run / "pdf_estimate.json").read_text())
    assert document["yaw"]["family"] == "von_mises"
    assert [c["family"] for c in document["pitch"]["candidates"]] == ["uniform", "normal", "kernel"]
    assert document["independence"]["rejected"] == (document["form"] == "joint")
    assert document["recording"]["name"] == "flight.csv"

    orientations = pdf.from_csv(str(run / "pdf.csv"))
    direct = estimated(OrientationRecording.from_csv(tmp_path / "flight.csv"), seed=0).pdf
    assert_allclose(orientations.yaw, direct.yaw)
    assert_allclose(orientations.weight, direct.weight)
    with initialize_config_dir(CONF, version_base="1.3"):
        read = instantiate(compose("optimise", ["pdf=samples", f"pdf.path={run / 'pdf.csv'}"]).pdf)
    assert_allclose(read.weight, orientations.weight)

    (tracked,) = MlflowClient(tracking_uri=f"sqlite:///{tmp_path}/store.db").search_runs(["1"])
    assert tracked.info.status == "FINISHED"
    assert tracked.data.metrics["samples"] == document["sampling"]["samples"]
    assert tracked.data.metrics["independence/p_value"] == document["independence"]["p_value"]


def test_a_recording_that_is_too_short_gets_one_sentence_and_leaves_nothing(tmp_path):
    simulated(duration=20.0).to_csv(tmp_path / "flight.csv")
    done = call("recording.path=flight.csv", cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith("error: flight.csv: 20 s at a mean interval of")
    assert len(done.stderr.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["flight.csv"]


def test_a_missing_path_is_named(tmp_path):
    done = call(cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith("error: recording.path is missing")
