"""Requests to a planner by its own page, by other pages and by programs."""

from http import HTTPStatus
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

import numpy as np
import pytest
from support.small import problem

from lmd.core.checks import InputError
from lmd.optimisers.genetic import RandomSearch
from lmd.optimisers.ledger import Budget
from lmd.planner.actions import Access
from lmd.planner.server import Planner
from lmd.planner.session import PlanningSession

viser = pytest.importorskip("viser")
from websockets.exceptions import InvalidStatus  # noqa: E402
from websockets.sync.client import connect  # noqa: E402

LIMIT = 60.0
REBOUND = "foreign.example"


@pytest.fixture(scope="module")
def address():
    planned = problem()
    session = PlanningSession(planned, planned.draw(np.random.default_rng(0)))
    planner = Planner(session, 0, lambda _: "", RandomSearch, Budget(1), seed=None)
    yield planner.address
    planner.close()


def asked(address, **headers):
    """Status and text of the answer to a request."""
    try:
        with urlopen(Request(address, headers=headers), timeout=LIMIT) as answer:
            return answer.status, answer.read().decode()
    except HTTPError as error:
        return error.code, error.read().decode()


def opened(address, origin):
    """Status of the answer to a request for a websocket."""
    try:
        address, protocol = address.rstrip("/").replace("http", "ws", 1), f"viser-v{viser.__version__}"
        with connect(address, origin=origin, subprotocols=[protocol], open_timeout=LIMIT) as connection:
            connection.recv(timeout=LIMIT)
            return HTTPStatus.SWITCHING_PROTOCOLS
    except InvalidStatus as refused:
        return refused.response.status_code


def changed(address):
    """Addresses of the same planner without its token."""
    port, token = urlsplit(address).port, urlsplit(address).path.strip("/")
    server = f"http://127.0.0.1:{port}"
    paths = ("", "/index.html", "/favicon.ico", f"/{token[:-1]}", f"/{token.swapcase()}/", f"/?{token}", f"//{token}/")
    return [server + path for path in paths]


def test_the_page_and_its_websocket_are_served_repeatedly(address):
    origin = "http://" + urlsplit(address).netloc
    for _ in range(2):
        status, text = asked(address)
        assert status == HTTPStatus.OK
        assert "<html" in text
        assert opened(address, origin) == HTTPStatus.SWITCHING_PROTOCOLS


def test_localhost_and_forwarded_ports_are_allowed(address):
    assert asked(address, Host="localhost:9000")[0] == HTTPStatus.OK
    local = address.replace("127.0.0.1", "localhost")
    assert opened(local, "http://" + urlsplit(local).netloc) == HTTPStatus.SWITCHING_PROTOCOLS


def test_without_the_token_nothing_is_served(address):
    for other in changed(address):
        status, text = asked(other)
        assert (status, "printed" in text) == (HTTPStatus.FORBIDDEN, True), other
        assert opened(other, "http://" + urlsplit(address).netloc) == HTTPStatus.FORBIDDEN, other


@pytest.mark.parametrize("host", [REBOUND, f"{REBOUND}:80", "127.0.0.1.foreign.example", "[::1", "127.0.0.1@x", ""])
def test_another_name_for_this_machine_is_refused(address, host):
    assert asked(address, Host=host)[0] == HTTPStatus.FORBIDDEN


def test_a_websocket_is_for_pages_of_the_same_origin_only(address):
    host, port = "127.0.0.1", urlsplit(address).port
    others = (f"http://{host}:{port + 1}", f"http://{host}", f"https://{host}:{port}", f"http://localhost:{port}")
    for origin in (None, "null", f"http://{REBOUND}:{port}", *others):
        assert opened(address, origin) == HTTPStatus.FORBIDDEN, origin


def test_the_token_is_new_each_time():
    assert len({Access().address(80) for _ in range(9)}) == 9


def test_a_server_without_checks_is_refused():
    with pytest.raises(InputError, match="would accept connections from every web page"), Access().checking():
        pass
