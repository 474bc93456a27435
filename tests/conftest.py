import gc

import pytest
from examples import DEFAULT, examples
from hypothesis import settings

from pipelines.app import GARBAGE

gc.set_threshold(GARBAGE)  # compiling makes many objects, too

settings.register_profile("lmd", examples(DEFAULT))
settings.load_profile("lmd")


@pytest.fixture
def write(tmp_path):
    def write_text(text, name="table.csv"):
        path = tmp_path / name
        path.write_text(text)
        return str(path)

    return write_text
