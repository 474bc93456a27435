"""Who may talk to the planner: whoever has its address, from a page that the planner itself has served.

Browsers let the page of any site open a websocket to this machine, and the server of viser takes every request. Three
checks keep other pages out, whether they connect from their own origin or make their own name mean this machine:

- the path begins with a token that is new with each start. The page finds its websocket below its own address, so it
  hands the token on by itself, also when it is reloaded or connects again;
- the header `Host` names this machine;
- the header `Origin` of a websocket is that of a page from the same host and port.
"""

import hmac
import re
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from http import HTTPStatus
from typing import Any

from lmd.core.checks import InputError
from lmd.core.optional import optional

HOST = "127.0.0.1"  # the planner listens there: other machines cannot reach it
LOCAL_ADDRESS = re.compile(r"(127\.0\.0\.1|localhost)(:\d+)?")  # any port: it may be forwarded
TOKEN_BYTES = 18

Answer = Callable[[Any, Any], Any]


class Access:
    """Answers what it refuses, and hands on what it lets in, without the token."""

    def __init__(self) -> None:
        self._path = f"/{secrets.token_urlsafe(TOKEN_BYTES)}"
        self._is_asked = False

    def address(self, port: int) -> str:
        """The one address that is let in."""
        return f"http://{HOST}:{port}{self._path}/"

    @contextmanager
    def checking(self) -> Iterator[None]:
        """While entered, a server of viser that starts asks here first.

        Raises:
            InputError: it did not, so everybody can talk to it.
        """
        server = optional("websockets.asyncio.server", "view")
        serve = server.serve

        def checked(*arguments: Any, process_request: Answer, **options: Any) -> Any:
            self._is_asked = True
            return serve(*arguments, process_request=partial(self._answer, process_request), **options)

        server.serve = checked  # viser has no other place for it
        try:
            yield
        finally:
            server.serve = serve
        if not self._is_asked:
            raise InputError("this version of viser cannot be kept from talking to every web page; 1.1.1 can.")

    def _answer(self, hand_on: Answer, connection: Any, request: Any) -> Any:
        """What a server of websockets calls `process_request`."""
        path = self._inner_path(request.path)
        if path is None:
            return connection.respond(HTTPStatus.FORBIDDEN, "This is not the address that the planner has printed.\n")
        if not _is_from_here(request.headers):
            return connection.respond(HTTPStatus.FORBIDDEN, "The planner talks to no page but its own.\n")
        return hand_on(connection, replace(request, path=path))

    def _inner_path(self, path: str) -> str | None:
        """A path without the token; None if it has another or none."""
        end = len(self._path)
        is_known = hmac.compare_digest(path[:end].encode(errors="replace"), self._path.encode())
        return (path[end:] or "/") if is_known else None


def _is_from_here(headers: Any) -> bool:
    """Whether a request was sent to this machine and, if it is for a websocket, by a page from there."""
    hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
    if len(hosts) != 1 or not LOCAL_ADDRESS.fullmatch(hosts[0]):
        return False
    return "Upgrade" not in headers or origins == [f"http://{hosts[0]}"]
