import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from support.strategies import pdfs

from lmd.geometry.frames import optical_axis, rotation
from lmd.scene import pdf
from lmd.sight import reference

BUILDERS = [pdf.grid_with_ends, pdf.grid_of_cells, pdf.solid_angle, pdf.level_flight]


def second_moment(orientations):
    return (orientations.axes.T * orientations.by_axis.weight) @ orientations.axes


@pytest.mark.parametrize(
    ("build", "count", "axes"),
    [(pdf.grid_with_ends, 325, 266), (pdf.grid_of_cells, 288, 288), (pdf.solid_angle, 288, 288)],
)
def test_the_grids_have_as_many_orientations_and_axes_as_printed(build, count, axes):
    assert (len(build().weight), len(build().axes)) == (count, axes)
    assert build is pdf.solid_angle or (build().weight == 1.0 / count).all()


def test_the_grid_with_ends_counts_the_poles_25_times_and_the_seam_twice():
    orientations = pdf.grid_with_ends()
    count = np.rint(orientations.by_axis.weight * 325).astype(int)
    assert count[0] == count[-1] == 25
    seam = np.abs(orientations.axes @ [0.0, -1.0, 0.0] - np.hypot(*orientations.axes[:, :2].T)) < 1e-9
    assert (count[1:-1] == np.where(seam, 2, 1)[1:-1]).all()


def test_the_grids_step_by_15_degrees_as_printed():
    step = math.pi / 12
    assert_allclose(np.unique(pdf.grid_with_ends().yaw), np.arange(-12, 13) * step, atol=1e-12)
    assert_allclose(np.unique(pdf.grid_with_ends().pitch), np.arange(-6, 7) * step, atol=1e-12)
    assert_allclose(np.unique(pdf.grid_of_cells().yaw), np.arange(-12, 12) * step, atol=1e-12)
    assert_allclose(np.unique(pdf.grid_of_cells().pitch), np.arange(-11, 12, 2) * step / 2, atol=1e-12)


@pytest.mark.parametrize("build", BUILDERS)
@given(divisions=st.integers(1, 30))
def test_every_pdf_sums_to_one(build, divisions):
    orientations = build(divisions)
    assert orientations.weight.min() > 0.0
    assert orientations.weight.sum() == pytest.approx(1.0, abs=1e-12)
    assert orientations.by_axis.weight.sum() == pytest.approx(1.0, abs=1e-12)


@given(pdfs)
def test_axes_are_unit_ordered_by_height_and_map_back_to_the_orientations(orientations):
    axes = orientations.axes
    assert_allclose(np.linalg.norm(axes, axis=1), 1.0)
    assert (np.diff(axes[:, 2]) > -1e-11).all()
    expected = optical_axis(orientations.yaw, orientations.pitch)
    assert_allclose(axes[orientations.by_axis.index_of], expected, rtol=0.0, atol=1e-11)


@given(pdfs)
def test_distinct_axes_carry_the_weight_of_their_orientations(orientations):
    seen = orientations.axes[:, 0] > 0.1
    by_orientation = reference.coverage_probability(seen[orientations.by_axis.index_of], orientations, 1)
    assert orientations.by_axis.weight[seen].sum() == pytest.approx(by_orientation, abs=1e-12)


@pytest.mark.parametrize(("divisions", "error"), [(6, 2e-2), (12, 5e-3), (24, 2e-3)])
def test_solid_angle_is_uniform_on_the_sphere(divisions, error):
    sphere = pdf.solid_angle(divisions)
    assert_allclose(sphere.by_axis.weight @ sphere.axes, 0.0, atol=1e-12)
    assert_allclose(second_moment(sphere), np.eye(3) / 3.0, atol=error)


def test_solid_angle_gives_a_polar_cap_its_share_of_the_sphere():
    sphere = pdf.solid_angle()
    above = sphere.weight[sphere.pitch > math.pi / 4].sum()
    assert above == pytest.approx((1.0 - math.sin(math.pi / 4)) / 2.0)


@pytest.mark.parametrize("build", [pdf.grid_with_ends, pdf.grid_of_cells])
def test_uniform_angles_are_not_uniform_on_the_sphere(build):
    assert second_moment(build())[2, 2] > 0.45


def test_level_flight_looks_all_around_at_one_pitch():
    level = pdf.level_flight(12)
    assert len(level.weight) == len(level.axes) == 24
    assert_allclose(level.axes[:, 2], 0.0)
    assert_allclose(pdf.level_flight(12, pitch=-0.3).axes[:, 2], math.sin(-0.3))


@pytest.mark.parametrize("count", [3, 7, 24, 325])
def test_weights_printed_with_six_decimals_are_accepted(count):
    printed = np.round(np.full(count, 1.0 / count), 6)
    assert len(pdf.OrientationPdf(np.linspace(-3.0, 3.0, count), np.zeros(count), printed).weight) == count


def test_a_pdf_cannot_be_changed_from_outside():
    weight = np.array([0.5, 0.5])
    orientations = pdf.OrientationPdf(np.zeros(2), np.zeros(2), weight)
    weight[:] = 7.0
    assert orientations.weight.tolist() == [0.5, 0.5]
    with pytest.raises(ValueError, match="read-only"):
        orientations.weight[0] = 1.0


def test_a_csv_is_read_by_column_name(write):
    orientations = pdf.from_csv(write("weight, pitch, yaw\n0.25,0.1,1\n0.75,-0.1,2\n"))
    assert orientations.yaw.tolist() == [1.0, 2.0]
    assert orientations.pitch.tolist() == [0.1, -0.1]
    assert orientations.weight.tolist() == [0.25, 0.75]


def test_roll_tells_orientations_apart_only_where_it_is_asked_for(tmp_path):
    angles = [0.0, 0.0, 1.0], [np.pi / 2, np.pi / 2, 0.0], [0.25, 0.25, 0.5]
    same = pdf.OrientationPdf(*angles, roll=[0.3, 0.3, 0.0])
    other = pdf.OrientationPdf(*angles, roll=[0.3, 0.4, 0.0])
    assert [len(p.by_axis.axes) for p in (same, other)] == [2, 2]
    assert [len(p.by_axis_and_roll.axes) for p in (same, other)] == [2, 3]
    axes, index_of, weight = other.by_axis_and_roll
    expected = rotation(other.yaw, other.pitch, other.roll)
    assert_allclose(axes[index_of], np.hstack([expected[:, 2], expected[:, 0]]), atol=1e-12)
    assert_allclose(weight[index_of], other.weight)
    other.to_csv(tmp_path / "pdf.csv")
    np.testing.assert_array_equal(pdf.from_csv(str(tmp_path / "pdf.csv")).roll, other.roll)


@pytest.mark.parametrize("build", BUILDERS)
def test_a_fixed_roll_stays_when_a_pdf_is_refined_or_drawn_from(build):
    rolled = build(4, roll=0.2)
    for other in (rolled, rolled.finer(), rolled.stratified(3, np.random.default_rng(0))):
        assert (other.roll == 0.2).all()
    assert (rolled.draw(10, np.random.default_rng(0))[2] == 0.2).all()


ROLLS = [[-0.2, 0.25], [0.0, 0.25], [0.3, 0.5]]


@pytest.mark.parametrize("build", BUILDERS)
def test_each_axis_comes_with_each_of_several_rolls(build):
    plain, rolled = build(4), build(4, roll=ROLLS)
    # Whoever does not ask for roll sees no difference.
    assert_allclose(rolled.by_axis.axes[:, :3], plain.by_axis.axes[:, :3])
    assert_allclose(rolled.by_axis.weight, plain.by_axis.weight)
    axes, index_of, _ = rolled.by_axis_and_roll
    assert len(axes) == 3 * len(plain.by_axis_and_roll.axes)
    expected = np.hstack([rotation(plain.yaw, plain.pitch, angle)[:, [2, 0]].reshape(-1, 6) for angle, _ in ROLLS])
    shown = axes[index_of].reshape(-1, 18)
    assert_allclose(shown, expected, atol=1e-12)
    for angle, share in ROLLS:
        assert_allclose(rolled.weight[rolled.roll == angle], share * plain.weight)
    finer = rolled.finer()
    assert finer.weight[finer.roll == 0.3].sum() == pytest.approx(0.5)


@pytest.mark.parametrize("build", BUILDERS)
def test_rolls_are_drawn_as_often_as_said_and_with_any_axis(build):
    rolled, rng = build(4, roll=ROLLS), np.random.default_rng(0)
    yaw, pitch, roll = rolled.draw(4000, rng)
    for drawn in (roll, np.asarray(rolled.stratified(45, rng).roll)):
        for angle, share in ROLLS:
            assert (drawn == angle).mean() == pytest.approx(share, abs=0.03)
    assert abs(np.corrcoef(yaw, roll)[0, 1]) < 0.05
    same = build(4).draw(4000, np.random.default_rng(0))
    np.testing.assert_array_equal((yaw, pitch), same[:2])


def test_of_the_yaw_alone_as_many_are_drawn_as_are_as_exact():
    level, rng = pdf.level_flight(6, pitch=0.1), np.random.default_rng(0)
    drawn = level.stratified(9, rng)
    assert (drawn.pitch == 0.1).all()
    np.testing.assert_array_equal(np.floor((drawn.yaw / np.pi + 1.0) * 27.0), np.arange(54))  # 2 x 9^1.5
    assert len(pdf.level_flight(6, roll=ROLLS).stratified(9, rng).yaw) == 162
