"""Handing in what a run could not send while it ran, and ending runs whose process is gone."""

import sys

from lmd.core.checks import InputError, printable

from .journal import Journal
from .processes import is_gone
from .store import Store, now

GONE = "its process is gone: it was killed, or the machine was switched off"


def hand_in(journal: Journal, uri: str) -> str:
    """Send all of a journal that a run left behind, and remove it; what the store has already is not doubled.

    Args:
        journal: of a run that has ended, one way or another.

    Returns:
        what was done, in one line.

    Raises:
        InputError: the store cannot be used, or the journal is none.
    """
    try:
        return _hand_in(journal, uri)
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, ArithmeticError, AttributeError) as error:
        raise InputError(
            f"the journal in {journal.path.parent} is none that a run has written ({type(error).__name__}: {error})."
        ) from error


def _hand_in(journal: Journal, uri: str) -> str:
    begins = [entry for entry in journal.entries if "run_id" in entry]
    if not begins:  # killed before it had a run
        journal.remove()
        return f"{journal.path} held nothing"
    last, entries = begins[-1], journal.entries
    ended = "end" in entries[-1]
    if not ended and not is_gone(last):
        return f"{journal.path} is left: its process still runs, or ran on another host ({last['host']})"
    store, run_id = Store(uri, last["experiment"]), last["run_id"]
    with store.errors_reported():
        run = store.client.get_run(run_id)
        if not ended and run.info.status == "RUNNING":
            entries = [*entries, {"end": "FAILED", "reason": GONE, "at": now()}]
        # Where it was continued in another folder, how it stands is for that one to say.
        went_on = run.data.tags.get("folder") != last["folder"]
        for entry in entries:
            if not (went_on and {"end", "reopen"} & set(entry)):
                store.send(run_id, entry)
    journal.remove()
    return f"{journal.path} is handed in: run {run.info.run_name} in {store.uri}"


def end_those_gone(store: Store) -> list[str]:
    """End as FAILED the runs whose process has gone from this host without ending them; returns their names."""
    ended = []
    for run in store.runs("attributes.status = 'RUNNING'"):
        if is_gone(run.data.tags):
            store.send(run.info.run_id, {"end": "FAILED", "reason": GONE, "at": now()})
            ended.append(str(run.info.run_name))
            print(f"{printable(run.info.run_name)} is ended as FAILED: {GONE}", file=sys.stderr)
    return ended
