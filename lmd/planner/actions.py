"""Requests from browsers: checks of connections, and a queue of actions that one thread runs in order."""

import hmac
import logging
import re
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from http import HTTPStatus
from queue import Empty, SimpleQueue
from typing import Any

from lmd.core.checks import InputError
from lmd.core.optional import optional

_LOG = logging.getLogger(__name__)

Action = Callable[[], None]


class ActionQueue:
    """Queue of actions: any thread may append an action, and one thread runs the actions."""

    def __init__(self) -> None:
        self._queue: SimpleQueue[Action] = SimpleQueue()

    def put(self, action: Action) -> None:
        """Append an action to the queue."""
        self._queue.put(action)

    def next(self, seconds: float) -> Action | None:
        """Wait for the next action and return it; None if no action comes within `seconds`."""
        try:
            return self._queue.get(timeout=seconds)
        except Empty:
            return None

    def on(self, register: Callable[[Any], object], answer: Callable[[Any], None]) -> None:
        """Arrange that each event of a kind, such as a click, appends a call of `answer` with the event to the queue.

        `register` is the function of viser that registers a callback for this kind of event.
        """
        call_in_order(register, partial(self.put_answer, answer))

    def put_answer(self, answer: Callable[..., None], *of_event: Any) -> None:
        """Append a call of `answer` with the arguments `of_event` to the queue.

        Browsers may send invalid values. So if the call fails, its error is replaced by an `InputError`.
        """
        self.put(partial(_answer, answer, *of_event))


def _answer(answer: Callable[..., None], *of_event: Any) -> None:
    try:
        answer(*of_event)
    except InputError:
        raise
    except Exception as error:
        _LOG.warning("an event that could not be answered", exc_info=True)
        raise InputError(f"the request cannot be carried out ({type(error).__name__}: {error}).") from error


def call_in_order(register: Callable[[Any], object], answer: Callable[[Any], None]) -> None:
    """Arrange that `answer` is called for each event of a kind, such as a drag, in the order of the events.

    `register` is the function of viser that registers a callback for this kind of event. Calls are in viser's own
    thread, so `answer` must not block.
    """

    async def call(event: Any) -> None:  # viser runs plain functions in a pool of threads, in any order
        answer(event)

    register(call)


HOST = "127.0.0.1"  # listening address, unreachable for other machines
LOCAL_ADDRESS = re.compile(r"(127\.0\.0\.1|localhost)(:\d+)?")  # with any port, as the port may be forwarded
TOKEN_BYTES = 18

Answer = Callable[[Any, Any], Any]


class Access:
    """Access control of the planner: the address of each request must contain a secret token.

    A request without the token is refused. Otherwise the token is removed, and the request is forwarded.
    """

    def __init__(self) -> None:
        self._path = f"/{secrets.token_urlsafe(TOKEN_BYTES)}"
        self._is_asked = False

    def address(self, port: int) -> str:
        """Address of the planner with the token; requests to all other addresses are refused."""
        return f"http://{HOST}:{port}{self._path}/"

    @contextmanager
    def checking(self) -> Iterator[None]:
        """Check all requests to a server of viser that starts within this context.

        Raises:
            InputError: the server has no hook for checking requests.
        """
        server = optional("websockets.asyncio.server", "view")
        serve = server.serve

        def checked(*arguments: Any, process_request: Answer, **options: Any) -> Any:
            self._is_asked = True
            return serve(*arguments, process_request=partial(self._answer, process_request), **options)

        server.serve = checked  # viser has no option for such a check
        try:
            yield
        finally:
            server.serve = serve
        if not self._is_asked:
            raise InputError("this version of viser would accept connections from every web page; install viser 1.1.1.")

    def _answer(self, hand_on: Answer, connection: Any, request: Any) -> Any:
        """Refuse a request, or forward it to `hand_on`, viser's own function for requests.

        The server calls this method as `process_request`.
        """
        path = self._inner_path(request.path)
        if path is None:
            return connection.respond(HTTPStatus.FORBIDDEN, "This is not the address that the planner has printed.\n")
        if not _is_from_here(request.headers):
            return connection.respond(HTTPStatus.FORBIDDEN, "The planner talks to no page but its own.\n")
        return hand_on(connection, replace(request, path=path))

    def _inner_path(self, path: str) -> str | None:
        """Path of a request without the token; None if the token is missing or wrong."""
        end = len(self._path)
        is_known = hmac.compare_digest(path[:end].encode(errors="replace"), self._path.encode())
        return (path[end:] or "/") if is_known else None


def _is_from_here(headers: Any) -> bool:
    """True if a request is addressed to this machine.

    A websocket must also have been opened by a page from the same address.
    """
    hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
    if len(hosts) != 1 or not LOCAL_ADDRESS.fullmatch(hosts[0]):
        return False
    return "Upgrade" not in headers or origins == [f"http://{hosts[0]}"]
