"""Work for idle moments, beside whoever changes the plan."""

import threading
from collections.abc import Callable
from functools import partial

from lmd.deployment import Deployment

Wanted = Callable[[], bool]


class Worker:
    """Works on one deployment at a time in a thread of its own; only the latest counts.

    Args:
        work: is given a deployment, and a function that says whether the outcome is still wanted.
    """

    def __init__(self, work: Callable[[Deployment, Wanted], None]) -> None:
        self._work = work
        self._asked: Deployment | None = None
        self._closing = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="worker")
        self._thread.start()

    def ask(self, deployment: Deployment | None) -> None:
        """Work on a deployment, or on none, and on no other any more."""
        with self._changed:
            self._asked = deployment
            self._changed.notify()

    def close(self) -> None:
        """End, as soon as the work at hand looks whether it is wanted."""
        with self._changed:
            self._asked, self._closing = None, True
            self._changed.notify()
        self._thread.join()

    def _run(self) -> None:
        done: Deployment | None = None
        while True:
            with self._changed:
                while not self._closing and (self._asked is None or self._asked is done):
                    self._changed.wait()
                if self._asked is None:
                    return
                at_hand = self._asked
            wanted = partial(self._is_asked, at_hand)
            self._work(at_hand, wanted)
            done = at_hand if wanted() else done  # else it was given up

    def _is_asked(self, deployment: Deployment) -> bool:
        return self._asked is deployment
