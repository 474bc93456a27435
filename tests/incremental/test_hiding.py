"""When a landmark is hidden and when it is not any more; the laws have the rest."""

from lmd.incremental.camera import turns


def test_a_landmark_flips_where_the_first_comes_to_hide_it_or_the_last_ceases_to():
    cases = [(0, 0), (0, 1), (1, 0), (1, 2), (2, 1), (0, 3)]
    assert [bool(turns(True, was, now)) for was, now in cases] == [False, True, True, False, False, True]
    assert not any(turns(False, was, now) for was, now in cases)
