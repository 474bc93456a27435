import multiprocessing
import signal
import threading
import time

import pytest

from lmd.core.threads import at_once, in_parts

THREADS = [1, 2, 3]


@pytest.mark.parametrize("threads", THREADS)
@pytest.mark.parametrize("size", [0, 1, 2, 7])
def test_results_come_in_the_order_of_the_arguments(threads, size):
    assert at_once(threads, lambda a, b: (a, b), range(size), "abcdefg"[:size]) == list(zip(range(size), "abcdefg"))  # noqa: B905


def test_so_many_threads_work_at_the_same_time():
    together = threading.Barrier(3, timeout=30.0)
    assert sorted(at_once(3, lambda _: together.wait(), range(3))) == [0, 1, 2]


def test_one_thread_is_the_calling_one():
    assert set(at_once(1, lambda _: threading.get_ident(), range(5))) == {threading.get_ident()}


@pytest.mark.parametrize("main", [True, False])
def test_after_an_error_of_one_thread_nothing_is_begun(main):
    together, begun = threading.Barrier(2, timeout=30.0), []

    def work(i):
        begun.append(i)
        if i < 2:  # each thread begins with one
            together.wait()
        if (threading.current_thread() is threading.main_thread()) is main:
            raise ValueError("one of both")
        time.sleep(0.05)

    with pytest.raises(ValueError, match="one of both"):
        at_once(2, work, range(50))
    assert len(begun) < 5


def test_told_to_stop_while_it_waits_it_waits_for_what_others_have_begun():
    both, done = threading.Barrier(2, timeout=30.0), []

    def work(i):
        both.wait()
        if threading.current_thread() is not threading.main_thread():
            time.sleep(0.5)
            done.append(i)

    def stop(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, stop)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.2)
        with pytest.raises(KeyboardInterrupt):
            at_once(2, work, range(2))
        assert len(done) == 1
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("threads", THREADS)
def test_shared_work_may_share_work(threads):
    inner = lambda i: sum(at_once(threads, lambda j: 10 * i + j, range(4)))  # noqa: E731
    assert at_once(threads, inner, range(20)) == [40 * i + 6 for i in range(20)]


@pytest.mark.parametrize("threads", THREADS)
@pytest.mark.parametrize(("size", "parts"), [(10, 3), (3, 10), (1, 1), (0, 4)])
def test_parts_are_all_of_it(threads, size, parts):
    done = []
    in_parts(threads, lambda first, last: done.append((first, last)), size, parts)
    assert sorted(i for first, last in done for i in range(first, last)) == list(range(size))
    assert len(done) == min(size, parts)


def _meet(queue):
    """All three threads at the same time, or a broken barrier."""
    together = threading.Barrier(3, timeout=10.0)
    try:
        queue.put(sorted(at_once(3, lambda _: together.wait(), range(3))))
    except threading.BrokenBarrierError as error:
        queue.put(repr(error))


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="processes cannot be forked here")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of forking with threads, which is what is tried
def test_a_forked_process_has_threads_of_its_own():
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    _meet(queue)
    assert queue.get(timeout=30.0) == [0, 1, 2]
    child = context.Process(target=_meet, args=(queue,))
    child.start()
    try:
        assert queue.get(timeout=30.0) == [0, 1, 2]
    finally:
        child.kill()
        child.join()
