"""Recording of runs in mlflow."""

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from lmd.core.checks import InputError

from .journal import GONE, Journal, end_those_gone, hand_in, this_process
from .store import PARAM_LENGTH, Store, now
from .tracker import Entry, NoTracker, RunStart
from .views import link, share, sweep_view, view_of

ADDRESS = "http://127.0.0.1:5000"  # address of the server that `make ui` starts
LABELS = {"TABLE": "table ", "CHART": "charts"}


class MlflowTracker(NoTracker):
    """Tracker that records runs in mlflow, by default in a sqlite file that needs no server.

    Every entry is written to a journal in the run's folder, then sent. If the store does not answer, one warning is
    printed and the run continues. Entries that were not sent by the end of the run stay in the journal, and `hand_in`
    can send them later.

    Args:
        uri: tracking store: `sqlite:///path` (relative to the working directory) or the address of a server.
        experiment_name: mlflow experiment that holds the runs.

    Raises:
        InputError: `uri` is not the address of a tracking store.
    """

    def __init__(self, uri: str, experiment_name: str) -> None:
        self.store = Store(uri, experiment_name)
        self._run_id: str | None = None
        self._journal: Journal | None = None
        self._sent, self._lost = 0, False  # number of entries already sent; True after the store failed to answer

    @property
    def run_id(self) -> str | None:
        """See `Tracker.run_id`."""
        return self._run_id

    def start(self, run: RunStart, run_id: str | None = None) -> None:
        """See `Tracker.start`."""
        store, place = self.store, {"folder": _absolute(run.folder), **this_process()}
        tags = {**run.tags, **place}
        known = None if run_id is None else store.find(run_id)
        with store.errors_reported() if known is None else nullcontext():
            if known is None:
                hand_in(Journal.of(run.folder), store.uri)
                end_those_gone(store)
            with store.undisturbed():
                run_id = store.create(run.name, _written(run.params), tags, run.ago) if known is None else run_id
                self._run_id, self._journal, self._sent = run_id, Journal.of(run.folder), 0
        began = {"uri": store.uri, "experiment": store.experiment_name, "run_id": run_id, **place}
        self._record(began if known is None else {**began, "reopen": tags})
        if run.dataset is not None:
            self._record({"dataset": run.dataset})

    def goes_on(self, run_id: str, folder: Path, params: Mapping[str, Any]) -> bool:
        """See `Tracker.goes_on`."""
        with self.store.errors_reported():
            hand_in(Journal.of(folder), self.store.uri)
        run = self.store.find(run_id)
        if run is None or run.data.tags.get("folder") != _absolute(folder):
            return False
        return run.info.status != "FINISHED" and run.data.params == _written(params)

    def _record(self, entry: Entry) -> None:
        """Write an entry to the journal, and send it unless the store no longer answers."""
        if self._journal is None:
            return
        self._journal.add(entry)
        if not self._lost:
            with self._warning():
                self._send(self._journal)

    def _send(self, journal: Journal) -> None:
        """Send the entries of the journal that have not been sent yet."""
        while self._sent < len(journal.entries):
            self.store.send(str(self._run_id), journal.entries[self._sent])
            self._sent += 1

    @contextmanager
    def _warning(self) -> Iterator[None]:
        """Context in which an error of the store becomes a warning, printed only once; other errors are raised."""
        try:
            with self.store.errors_reported():
                yield
        except InputError as error:
            if not self._lost:
                print(f"warning: {error}; the run goes on", file=sys.stderr)
            self._lost = True

    def log_curve(self, metric: str, points: Iterable[tuple[int, float, float]]) -> None:
        """See `Tracker.log_curve`."""
        self._record({"metric": metric, "curve": [(step, float(value), at) for step, value, at in points]})

    def log_metrics(self, metrics: Mapping[str, float]) -> None:
        """See `Tracker.log_metrics`."""
        self._record({"metrics": {key: float(value) for key, value in metrics.items()}, "at": now()})

    def log_artifacts(self, paths: Iterable[Path]) -> None:
        """See `Tracker.log_artifacts`."""
        self._record({"files": [_absolute(path) for path in paths]})

    def finish(self, status: str, reason: str = "") -> None:
        """See `Tracker.finish`."""
        if (journal := self._journal) is None:
            return
        journal.add({"end": status, "reason": reason, "at": now()})
        with self._warning():
            self._send(journal)
            figures = dict.fromkeys(name for entry in journal.entries for name in entry.get("metrics", ()))
            share(self.store.client, self.store.experiment_id, view_of(list(figures)))
            journal.remove()
            return
        try:
            journal.write()
        except OSError as full:
            print(f"warning: what the run has recorded is lost: {full}", file=sys.stderr)

    def settle(self, run: RunStart, status: str, reason: str = "", files: Sequence[Path] = ()) -> None:
        """See `Tracker.settle`; the command `mlflow gc` later erases the deleted attempts for good."""
        store, wanted = self.store, " and ".join(f"tags.`{key}` = '{value}'" for key, value in run.tags.items())
        with store.errors_reported():
            found = sorted(store.matching(wanted), key=lambda each: each.info.start_time)
            for each in found:
                # Another run that began meanwhile may have ended this run with the reason `GONE`.
                if each.info.status == "RUNNING" or each.data.tags.get("reason") == GONE:
                    store.send(each.info.run_id, {"end": status, "reason": reason, "at": now()})
            for each in found[:-1]:
                store.client.delete_run(each.info.run_id)
            if found:
                store.send(found[-1].info.run_id, {"files": list(map(_absolute, files))})
        if not found and status != "FINISHED":
            self.start(run)
            self.log_artifacts(files)
            self.finish(status, reason)

    def discard(self) -> None:
        """See `Tracker.discard`."""
        if self._run_id is not None and self._journal is not None:
            with self.store.errors_reported():
                self.store.client.delete_run(self._run_id)
            self._journal.remove()
            self._run_id = self._journal = None

    def describe(self) -> str:
        """See `Tracker.describe`."""
        from ...app import IN_CHECKOUT, command_of

        uri, journal = self.store.uri, self._journal
        if journal is not None and journal.path.exists():
            again = f"{command_of('runs')} sync={journal.path.parent} tracking.uri={uri}"
            return f"not in {uri} yet; when the server answers again, run: {again}"
        shown_by = "make ui" if IN_CHECKOUT else f"mlflow ui --backend-store-uri {uri}"
        return f"run {self._run_id} in {uri}" + (f" ({shown_by})" if self.store.is_local else "")

    def views(self, params: Sequence[str]) -> list[str]:
        """See `Tracker.views`."""
        store, run_id = self.store, self._run_id
        address = ADDRESS if store.is_local else store.uri.rstrip("/")
        if run_id is not None and not self._lost:
            with self._warning():
                experiment = store.experiment_id
                share(store.client, experiment, sweep_view(run_id, params), run_id)
                return [f"{label} {link(address, experiment, run_id, mode)}" for mode, label in LABELS.items()]
        return []


def _written(params: Mapping[str, Any]) -> dict[str, str]:
    """Parameters as texts, in the form in which mlflow stores them."""
    return {key: str(value)[:PARAM_LENGTH] for key, value in params.items()}


def _absolute(path: Path) -> str:
    return str(path.resolve())
