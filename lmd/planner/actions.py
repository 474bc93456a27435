"""Actions: requests from browsers and threads in a queue, which one thread runs in order."""

import logging
from collections.abc import Callable
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any

from lmd.core.checks import InputError

_LOG = logging.getLogger(__name__)

Action = Callable[[], None]


class ActionQueue:
    """Queue of actions: any thread may append an action, and one thread runs the actions."""

    def __init__(self) -> None:
        self._queue: SimpleQueue[Action] = SimpleQueue()

    def put(self, action: Action) -> None:
        """Append an action."""
        self._queue.put(action)

    def next(self, seconds: float) -> Action | None:
        """Wait for the next action; None if there is none within `seconds`."""
        try:
            return self._queue.get(timeout=seconds)
        except Empty:
            return None

    def on(self, register: Callable[[Any], object], answer: Callable[[Any], None]) -> None:
        """Append `answer` for each event of viser; `register` takes viser's callback."""
        call_in_order(register, partial(self.put_answer, answer))

    def put_answer(self, answer: Callable[..., None], *of_event: Any) -> None:
        """Append the answer to a browser's event.

        Browsers may send any values. An answer that fails because of such values raises only InputError.
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


def call_in_order(register: Callable[[Any], object], answer: Callable[[Any], None]) -> None:
    """Call `answer` for events of viser in viser's own thread; `answer` must not block."""

    async def call(event: Any) -> None:  # viser runs plain functions in a pool of threads, in any order
        answer(event)

    register(call)
