"""Displacements of tags, compared with dense least squares that has the displacement as an unknown."""

import numpy as np
import pytest

from lmd.localise.displacement import LinearMap, rows_of

TAGS, REST = 4, 9  # tags, of which the first three are trusted, and other unknowns


def problem(seed):
    """Information and gradient of sightings about u = 0, and a covariance of the map."""
    rng = np.random.default_rng(seed)
    size = 6 * TAGS + REST
    root = rng.normal(size=(size, 3 * size)) * 30.0
    half = rng.normal(size=(6 * TAGS, 6 * TAGS)) * 0.03
    return root @ root.T, rng.normal(size=size) * 100.0, half @ half.T


def linear(information, gradient, covariance):
    """`LinearMap` of a problem, eliminated by hand."""
    trusted, rest = rows_of(np.arange(TAGS - 1)), np.arange(6 * (TAGS - 1), len(information))
    whole = np.linalg.inv(information[np.ix_(rest, rest)])
    gain, step = -whole @ information[np.ix_(rest, trusted)], whole @ gradient[rest]
    kept = information[np.ix_(trusted, trusted)] + information[np.ix_(trusted, rest)] @ gain
    pull = gradient[trusted] - information[np.ix_(trusted, rest)] @ step
    return LinearMap(
        covariance, trusted, rows_of(np.array([TAGS - 1])), np.zeros(6 * TAGS), kept, pull,
        whole[:6, :6], gain[:6], step[:6],
    )  # fmt: skip


@pytest.mark.parametrize("tag", [0, 2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_a_displacement_is_that_of_least_squares_with_the_displacement_as_an_unknown(tag, seed):
    """Unknowns are all twists, the rest and t; the prior holds for the trusted tags and for u_k - t."""
    information, gradient, covariance = problem(seed)
    size = len(information)
    with_prior = rows_of(np.unique([*range(TAGS - 1), tag]))
    prior = np.zeros((size + 6, size + 6))
    select = np.zeros((len(with_prior), size + 6))
    select[np.arange(len(with_prior)), with_prior] = 1.0
    select[np.flatnonzero(np.isin(with_prior, rows_of(np.array([tag])))), size + np.arange(6)] = -1.0
    prior += select.T @ np.linalg.inv(covariance[np.ix_(with_prior, with_prior)]) @ select
    prior[:size, :size] += information
    whole = np.linalg.inv(prior)
    found = linear(information, gradient, covariance).displacement(tag)
    assert found is not None
    np.testing.assert_allclose(found[0], (whole[:, :size] @ gradient)[size:], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found[1], whole[size:, size:], rtol=1e-6, atol=1e-12)


def test_covariances_are_those_of_the_inverse_of_all_information():
    information, gradient, covariance = problem(5)
    trusted = rows_of(np.arange(TAGS - 1))
    every = information.copy()
    every[np.ix_(trusted, trusted)] += np.linalg.inv(covariance[np.ix_(trusted, trusted)])
    expected = np.linalg.inv(every)
    found = linear(information, gradient, covariance).covariances
    for k in range(TAGS):
        rows = slice(6 * k, 6 * k + 6)
        np.testing.assert_allclose(found[k], expected[rows, rows], rtol=1e-6)


def test_a_singular_covariance_of_the_map_is_no_obstacle():
    """All tags but their common motion are exact: the tag that was moved is known as well as the sightings know it."""
    information, gradient, _ = problem(7)
    common = np.tile(np.eye(6), (TAGS, 1)) * 0.01
    found = linear(information, gradient, common @ common.T).displacement(1)
    nearly = linear(information, gradient, common @ common.T + 1e-12 * np.eye(6 * TAGS)).displacement(1)
    assert found is not None
    assert nearly is not None
    np.testing.assert_allclose(found[1], nearly[1], rtol=1e-3)
