"""Number of examples that property tests draw: few in `make test`, many in `make test-thorough`."""

import os

from hypothesis import settings

SHARE = float(os.environ.get("LMD_EXAMPLES", "0.3"))
DEFAULT = 100  # number of examples of a test without its own


def examples(number):
    """Settings of a test with this number of examples; no deadline, as the first may wait for a compiler."""
    return settings(max_examples=max(1, round(SHARE * number)), deadline=None)
