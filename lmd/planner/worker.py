"""Work for idle moments, beside whoever changes the plan."""

import threading
from collections.abc import Callable
from functools import partial

from lmd.core.checks import InputError
from lmd.scene.deployment import Deployment

PATIENCE_SECONDS = 0.5  # seconds that work which nobody wants is waited for

Wanted = Callable[[], bool]


class Worker:
    """Works on one deployment at a time in a thread of its own, which ends with the process; only the latest counts.

    Args:
        work: is given a deployment, and a function that says whether the outcome is still wanted.
        failed: is given a deployment that could not be worked on, in that thread, and why, in a sentence.
    """

    def __init__(self, work: Callable[[Deployment, Wanted], None], failed: Callable[[Deployment, str], None]) -> None:
        self._work, self._failed = work, failed
        self._question: tuple[Deployment] | None = None  # another one each time it is asked
        self._closing = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="worker", daemon=True)
        self._thread.start()

    def ask(self, deployment: Deployment | None) -> None:
        """Work on a deployment and on no other any more, once until another or None is asked; None for none."""
        with self._changed:
            if deployment is None:
                self._question = None
            elif self._question is None or self._question[0] is not deployment:
                self._question = (deployment,)
                self._changed.notify()

    def close(self) -> None:
        """End, as soon as the work at hand looks whether it is wanted; while it compiles it does not look."""
        with self._changed:
            self._question, self._closing = None, True
            self._changed.notify()
        self._thread.join(PATIENCE_SECONDS)

    def _run(self) -> None:
        done: tuple[Deployment] | None = None
        while True:
            with self._changed:
                while not self._closing and (self._question is None or self._question is done):
                    self._changed.wait()
                if self._question is None:
                    return
                done = self._question
            try:
                self._work(done[0], partial(self._is_asked, done))
            except (InputError, MemoryError) as error:
                self._failed(done[0], str(error) or "there is too little memory.")

    def _is_asked(self, question: tuple[Deployment]) -> bool:
        return self._question is question
