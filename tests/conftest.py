import gc

import pytest
from examples import DEFAULT, examples
from hypothesis import settings

from lmd.threads import available_threads
from pipelines.app import GARBAGE

gc.set_threshold(GARBAGE)  # compiling makes many objects, too

settings.register_profile("lmd", examples(DEFAULT))
settings.load_profile("lmd")


def pytest_xdist_auto_num_workers():
    """One more than processors: every other test waits for a server, a browser or a cluster."""
    return available_threads() + 1


@pytest.fixture
def write(tmp_path):
    def write_text(text, name="table.csv"):
        path = tmp_path / name
        path.write_text(text)
        return str(path)

    return write_text
