"""Number of examples that property tests draw: few in `make test`, many in `make test-thorough`."""

import os

from hypothesis import settings

SHARE = float(os.environ.get("LMD_EXAMPLES", "0.3"))
DEFAULT = 100  # of a test that does not say


def examples(number):
    """Settings of a test that is worth so many examples; deadlines are off, as the first may wait for a compiler."""
    return settings(max_examples=max(1, round(SHARE * number)), deadline=None)
