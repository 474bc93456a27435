"""What is to be done, one after the other, by whichever threads it was asked for."""

from collections.abc import Callable
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any

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
        in_order(register, lambda event: self.put(partial(answer, event)))


def in_order(register: Callable[[Any], object], answer: Callable[[Any], None]) -> None:
    """Call `answer` for events of viser in its own thread, which must not be held up."""

    async def call(event: Any) -> None:  # plain functions go to a pool of threads and may overtake each other
        answer(event)

    register(call)
