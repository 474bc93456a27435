import math

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from lmd.core.checks import InputError
from lmd.geometry.distortion import (
    coefficients,
    distort,
    greatest_stretch,
    jacobian,
    turning_point,
    undistort,
    widest_ray,
)

radial, tangential = st.floats(-0.5, 0.5), st.floats(-0.02, 0.02)
lenses = st.tuples(radial, radial, tangential, tangential, radial)


def disc(radius):
    """Rays all over a disc, on its edge too, `(4096, 2)`."""
    r, angle = np.meshgrid(radius * np.linspace(0.0, 1.0, 64), np.linspace(0.0, 2.0 * math.pi, 64))
    return np.stack([r * np.cos(angle), r * np.sin(angle)], axis=-1).reshape(-1, 2)


@given(lenses)
def test_the_jacobian_is_the_slope(lens):
    rays, step = disc(0.9), 1e-6
    moved = [(distort(rays + way, lens) - distort(rays - way, lens)) / (2.0 * step) for way in step * np.eye(2)]
    np.testing.assert_allclose(jacobian(rays, lens), np.stack(moved, axis=-1), atol=1e-8)


@given(lenses)
def test_below_the_turning_point_the_distortion_has_an_inverse(lens):
    radius = min(0.9 * turning_point(lens), 2.0)
    rays = disc(radius)
    slope = jacobian(rays, lens)
    assert (np.linalg.eigvalsh(slope) > 0.0).all()
    # What the farthest rays show lies farther out than that of any nearer one: nothing folds.
    inner = np.linalg.norm(distort(0.9 * rays, lens) - distort(np.zeros(2), lens), axis=-1)
    assert (inner <= np.linalg.norm(distort(disc(radius), lens), axis=-1).max()).all()
    np.testing.assert_allclose(undistort(distort(rays, lens), lens), rays, atol=1e-7)


@given(lenses, st.floats(0.05, 1.2))
def test_no_ray_beyond_the_widest_is_in_the_image(lens, reach):
    radius, turn = widest_ray(lens, reach), turning_point(lens)
    assume(radius < turn)
    outside = disc(1.0)[np.hypot(*disc(1.0).T) > 0.999] * np.linspace(radius, min(0.999 * turn, 3.0), 20)[:, None, None]
    assert (np.linalg.norm(distort(outside, lens), axis=-1) >= reach * (1.0 - 1e-9)).all() or radius > 3.0
    # And it is no wider than it must be: without tangential terms its image is on the circle.
    straight = (lens[0], lens[1], 0.0, 0.0, lens[4])
    bound = widest_ray(straight, reach)
    if bound < turning_point(straight):
        assert distort(np.array([bound, 0.0]), straight)[0] == pytest.approx(reach)


@given(lenses, st.floats(0.05, 1.2))
@example((0.0, 0.5, 0.0, 0.0, -0.25), 1.0)  # grows and falls by much in every ring
def test_no_ray_is_stretched_more_than_the_bound(lens, radius):
    assume(radius < turning_point(lens))
    greatest = np.linalg.eigvalsh(jacobian(disc(radius), lens)).max()
    assert greatest <= greatest_stretch(lens, radius) * (1.0 + 1e-12)
    straight = lens[0], lens[1], 0.0, 0.0, lens[4]
    assert greatest_stretch(straight, radius) <= 1.05 * np.linalg.eigvalsh(jacobian(disc(radius), straight)).max()


def test_by_hand():
    # r (1 - r^2 / 3) is largest at r = 1, where it is 2/3.
    assert turning_point((-1 / 3, 0.0, 0.0, 0.0, 0.0)) == pytest.approx(1.0)
    assert turning_point((0.2, 0.1, 0.0, 0.0, 0.0)) == math.inf
    assert widest_ray((-1 / 3, 0.0, 0.0, 0.0, 0.0), 0.5 - 0.125 / 3) == pytest.approx(0.5)
    assert greatest_stretch((0.5, 0.0, 0.0, 0.0, 0.0), 1.0) == pytest.approx(2.5)
    assert greatest_stretch((-0.1, 0.0, 0.0, 0.0, 0.0), 1.0) == 1.0


def test_coefficients():
    assert coefficients([]) == coefficients([0, 0, 0, 0]) == ()
    assert coefficients([0.1, 0.2, 0.3, 0.4]) == (0.1, 0.2, 0.3, 0.4, 0.0)
    assert coefficients((1, 2, 3, 4, 5)) == (1.0, 2.0, 3.0, 4.0, 5.0)
    for wrong in ([0.1, 0.2], 0.1, "abcd", None):
        with pytest.raises(InputError, match=r"^distortion must be \[\] or \[k1, k2, p1, p2\] or with k3, got"):
            coefficients(wrong)
    with pytest.raises(InputError, match=r"^distortion\[1\] must be finite"):
        coefficients([0.1, math.nan, 0.0, 0.0])
