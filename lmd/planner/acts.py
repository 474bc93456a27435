"""What is to be done, one after the other, by whichever threads it was asked for."""

import logging
from collections.abc import Callable
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any

from lmd.core.checks import InputError

_LOG = logging.getLogger(__name__)

Act = Callable[[], None]


class Acts:
    """A queue of acts: any thread may put one in, one thread takes them out."""

    def __init__(self) -> None:
        self._queue: SimpleQueue[Act] = SimpleQueue()

    def put(self, act: Act) -> None:
        """Let something be done when all that was put in before is."""
        self._queue.put(act)

    def next(self, seconds: float) -> Act | None:
        """The next act; None if there is none for so long."""
        try:
            return self._queue.get(timeout=seconds)
        except Empty:
            return None

    def on(self, register: Callable[[Any], object], answer: Callable[[Any], None]) -> None:
        """Let events of viser be answered in their turn; `register` takes a callback."""
        in_order(register, partial(self.put_answer, answer))

    def put_answer(self, answer: Callable[..., None], *of_event: Any) -> None:
        """Let something be done that a browser asked for.

        Browsers send what they like: where it makes no sense the act raises InputError, and no other.
        """
        self.put(partial(_answer, answer, *of_event))


def _answer(answer: Callable[..., None], *of_event: Any) -> None:
    try:
        answer(*of_event)
    except InputError:
        raise
    except Exception as error:
        _LOG.warning("an event that could not be answered", exc_info=True)
        raise InputError(f"that cannot be done ({type(error).__name__}: {error}).") from error


def in_order(register: Callable[[Any], object], answer: Callable[[Any], None]) -> None:
    """Call `answer` for events of viser in its own thread, which must not be held up."""

    async def call(event: Any) -> None:  # plain functions go to a pool of threads and may overtake each other
        answer(event)

    register(call)
