"""Work for idle moments, beside whoever changes the plan."""

import threading
from collections.abc import Callable
from functools import partial
from typing import Generic, TypeVar

from lmd.core.checks import InputError

PATIENCE_SECONDS = 0.5  # seconds that work which nobody wants is waited for

Question = TypeVar("Question")
Wanted = Callable[[], bool]


class Worker(Generic[Question]):
    """Works on one question at a time in a thread of its own, which ends with the process; only the latest counts.

    Args:
        work: is given a question, and a function that says whether the answer is still wanted.
        failed: is given a question that could not be worked on, in that thread, and why, in a sentence.
    """

    def __init__(self, work: Callable[[Question, Wanted], None], failed: Callable[[Question, str], None]) -> None:
        self._work, self._failed = work, failed
        self._question: tuple[Question] | None = None  # another one each time it is asked
        self._closing = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="worker", daemon=True)
        self._thread.start()

    def ask(self, question: Question | None) -> None:
        """Work on a question and on no other any more, once until another or None is asked; None for none."""
        with self._changed:
            if question is None:
                self._question = None
            elif self._question is None or self._question[0] is not question:
                self._question = (question,)
                self._changed.notify()

    def close(self) -> None:
        """End, as soon as the work at hand looks whether it is wanted; while it compiles it does not look."""
        with self._changed:
            self._question, self._closing = None, True
            self._changed.notify()
        self._thread.join(PATIENCE_SECONDS)

    def _run(self) -> None:
        done: tuple[Question] | None = None
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

    def _is_asked(self, question: tuple[Question]) -> bool:
        return self._question is question
