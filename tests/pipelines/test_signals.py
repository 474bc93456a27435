"""Effects of a signal at each stage of a process."""

import os
import signal
import subprocess

import pytest
from mlflow import MlflowClient
from support.processes import LIMIT, command, start

from pipelines.operations.signals import SIGNALS, Stop, Stopped
from pipelines.operations.tracking import MlflowTracker, RunStart


@pytest.fixture(name="stop")
def _stop(monkeypatch):
    """What hears the signals of this process, during a test."""
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")  # as it was, it is again after the test
    before = {number: signal.getsignal(number) for number in SIGNALS}
    stop = Stop()
    stop.listen()
    yield stop
    for number, handler in before.items():
        signal.signal(number, handler)


def test_the_first_raises_and_what_follows_does_not_disturb_the_cleaning_up(stop):
    def work():
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(Stopped) as told, stop.raising():
        work()
    assert told.value.code == stop.code == 128 + signal.SIGTERM


def test_what_goes_wrong_meanwhile_is_reported_once_and_changes_nothing(stop, capfd):
    def library():
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            raise AttributeError("left as it was when the signal came")

    with pytest.raises(Stopped) as told, stop.raising(), stop.raising():
        library()
    assert told.value.code == 128 + signal.SIGTERM
    said = ["stopping", "while stopping: AttributeError: left as it was when the signal came"]
    assert capfd.readouterr().err.split("\n\n") == [f"\n{said[0]}", f"{said[1]}\n"]


def test_an_error_after_it_was_heard_is_an_error(stop):
    def work():
        with pytest.raises(Stopped), stop.deferred(lambda: False):
            signal.raise_signal(signal.SIGTERM)
        raise ValueError("another matter")

    with pytest.raises(ValueError, match="another matter"), stop.raising():
        work()


def test_deferred_the_second_raises(stop, capfd):
    with stop.deferred(lambda: True):
        signal.raise_signal(signal.SIGINT)
        assert stop.requested
        with pytest.raises(Stopped):
            signal.raise_signal(signal.SIGINT)
    assert "interrupt again to stop at once" in capfd.readouterr().err


def test_deferred_the_first_raises_where_there_is_nothing_to_wait_for(stop):
    with pytest.raises(Stopped), stop.deferred(lambda: False):
        signal.raise_signal(signal.SIGINT)


def test_shielded_it_is_noted_and_no_more(stop):
    with stop.raising(), stop.shielded():
        signal.raise_signal(signal.SIGINT)
    assert stop.requested


@pytest.mark.parametrize("times", [1, 2, 3])
def test_postponed_they_act_at_its_end_as_they_would_have_done(stop, times):
    reached = []
    try:
        with stop.deferred(lambda: True), stop.postponed():
            for _ in range(times):
                signal.raise_signal(signal.SIGINT)
            reached.append("end")
    except Stopped:
        reached.append("raised")
    assert stop.requested
    assert reached == (["end"] if times == 1 else ["end", "raised"])


@pytest.mark.slow
def test_a_database_is_never_left_locked(stop, tmp_path, monkeypatch):
    uri = f"sqlite:///{tmp_path}/mlflow.db"
    monkeypatch.setattr("pipelines.operations.tracking.store.stop", stop)
    tracker = MlflowTracker(uri, "tests")
    tracker.start(RunStart("a run", tmp_path))
    log_batch, told = tracker.store.client.log_batch, [signal.SIGINT, signal.SIGTERM]

    def interrupted(*args, **kwargs):
        while told:
            signal.raise_signal(told.pop())
        log_batch(*args, **kwargs)

    monkeypatch.setattr(tracker.store.client, "log_batch", interrupted)
    with pytest.raises(Stopped), stop.deferred(lambda: True):
        tracker.log_metrics({"qualified_ratio": 0.5})
    tracker.finish("KILLED")
    run = MlflowClient(tracking_uri=uri).get_run(tracker.run_id)
    assert run.data.metrics == {"qualified_ratio": 0.5}
    assert run.info.status == "KILLED"


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("runs --help", signal.SIGPIPE),
        ("evaluate deployment=uniform room.spacing=2 validate=false picture=false tracking=none hydra.run.dir=run", 0),
    ],
)
def test_a_command_outlives_its_reader_and_what_is_only_printed_ends_quietly(words, code, tmp_path):
    reading, writing = os.pipe()
    os.close(reading)
    name, *given = words.split()
    line = command(name, *given, settings=())
    process = start(line, cwd=tmp_path, stdout=writing, stderr=subprocess.PIPE, fresh=True)
    os.close(writing)
    _, told = process.communicate(timeout=LIMIT)
    # 128 more, or negative, for a process that the signal has ended
    assert (abs(process.returncode) % 128, "Traceback" in told, "error" in told) == (code, False, False), told
    assert (tmp_path / "run" / "metrics.json").is_file() == (name == "evaluate")
