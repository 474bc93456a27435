import signal

import pytest

from pipelines.workers import in_processes


def ignores_interrupts(_job):
    return signal.getsignal(signal.SIGINT) == signal.SIG_IGN


@pytest.fixture
def _heard():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may have made this process ignore it
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("_heard")
def test_a_terminal_that_interrupts_the_workers_is_left_to_who_began_them():
    """One that raised would print a traceback, and the pool wait for ever for what it had in hand."""
    assert list(in_processes(ignores_interrupts, range(3), workers=2, ordered=True)) == [True] * 3
    assert not ignores_interrupts(0)
