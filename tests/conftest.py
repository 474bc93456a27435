import ctypes
import gc
import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before it is loaded: workers and what they start share processors

import pytest
from hypothesis import settings
from support import processes, thorough
from support.thorough import DEFAULT, examples

from lmd.core import workers
from lmd.core.threads import available_threads

gc.disable()  # see pytest_runtest_logfinish

settings.register_profile("lmd", examples(DEFAULT))
settings.load_profile("lmd")


PLENTY, GROWN = 2**30, 2**27  # bytes in memory


def pytest_runtest_logfinish():
    """After a test: compiling leaves garbage, and C keeps what is free.

    Left to itself, Python would look for garbage too often among what stays, and too seldom where there is much.
    """
    if _in_memory() > _limit[0]:
        gc.collect()
        gc.freeze()
        ctypes.CDLL(None).malloc_trim(0)
        _limit[0] = max(PLENTY, _in_memory() + GROWN)


_limit = [PLENTY]


def _in_memory():
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def pytest_collection_finish():
    """What is imported by now stays: looking for garbage need not look at it."""
    gc.collect()
    gc.freeze()


def pytest_sessionfinish():
    """Nor need the process when it ends."""
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node):
    """The processes of all workers' tests are forked from one."""
    node.workerinput["server"] = processes.ensure_warm()


def pytest_configure(config):
    if hasattr(config, "workerinput"):
        processes.use_server(config.workerinput["server"])


def pytest_xdist_auto_num_workers():
    """One more than processors, as some tests wait for a process; each takes 10 s to import what all tests need."""
    return available_threads() + 1


def pytest_collection_modifyitems(config, items):
    """Leave out what `thorough` leaves out, and begin with long files.

    The last of them would else run while other workers have nothing left to do.
    """
    left_out = [item for item in items if not thorough.is_due(item)]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in set(left_out)]
    long, slow = ({item.path for item in items if item.get_closest_marker(mark)} for mark in ("long", "slow"))
    items.sort(key=lambda item: (item.path not in long, item.path not in slow))


workers.ready_server = processes.ensure_warm  # all that a test starts is forked from one process


@pytest.fixture
def write(tmp_path):
    def write_text(text, name="table.csv"):
        path = tmp_path / name
        path.write_text(text)
        return str(path)

    return write_text
