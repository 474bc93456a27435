import numpy as np

from lmd.space.gridded import kronecker, latin_hypercube


def test_numbers_at_one_place_are_spread_out_and_uniform():
    drawn = latin_hypercube(5, (400, 3), np.random.default_rng(0))
    assert drawn.shape == (5, 400, 3)
    np.testing.assert_array_equal(
        np.sort(np.floor(5 * drawn), axis=0), np.broadcast_to(np.arange(5.0)[:, None, None], drawn.shape)
    )
    # Each is uniform, and sides and places have nothing to do with each other.
    within = np.histogram(drawn[0], bins=5, range=(0.0, 1.0))[0]
    assert (abs(within - 240) < 5 * np.sqrt(240)).all()
    correlation = np.corrcoef(np.vstack([drawn[:, :, 0].ravel(), drawn[:, :, 1].ravel(), drawn[:, ::-1, 0].ravel()]))
    assert (abs(correlation[np.triu_indices(3, 1)]) < 0.12).all()


def test_points_fill_the_cube_evenly_from_a_random_shift():
    rng = np.random.default_rng(0)
    following = kronecker(rng.random(3))
    points = np.concatenate([following(300), following(724)])
    octants = np.unique((points > 0.5) @ [1, 2, 4], return_counts=True)[1]
    assert len(octants) == 8
    assert octants.std() < 6.0  # that of independent ones is 11
    firsts = np.array([kronecker(rng.random(3))(1)[0] for _ in range(2000)])
    assert (abs(firsts.mean(axis=0) - 0.5) < 5 * np.sqrt(1 / 12 / 2000)).all()
    assert (abs(np.corrcoef(firsts.T)[np.triu_indices(3, 1)]) < 0.12).all()
