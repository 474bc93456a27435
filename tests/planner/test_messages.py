"""A planner refuses invalid messages and still serves the next browser; it shows why background work failed."""

from contextlib import closing
from functools import partial
from urllib.parse import urlsplit

import numpy as np
import pytest
from support.small import problem
from support.tables import rows

from lmd.core.checks import InputError
from lmd.optimisers.genetic import RandomSearch
from lmd.optimisers.ledger import Budget
from lmd.planner.panel import PlannerPanel
from lmd.planner.server import Planner
from lmd.planner.session import PlanningSession

viser = pytest.importorskip("viser")
import msgspec  # noqa: E402
import zstandard  # noqa: E402
from websockets.sync.client import connect  # noqa: E402

LIMIT = 60.0
# A drag is to a place that is not finite, so that it changes nothing, whichever of its events are applied.
CAMERA, POINTED, DRAGGED = rows(__file__, "messages of a browser").values()
NAN, HUGE = float("nan"), 1e308


class Ended(KeyboardInterrupt):
    """Ends the planner, as Ctrl-C does."""


def begun(save):
    planned = problem()
    session = PlanningSession(planned, planned.draw(np.random.default_rng(0)))
    return session, Planner(session, 0, save, RandomSearch, Budget(1), seed=None)


def shown_to(connection):
    """Messages that a browser receives when it connects."""
    found = []
    while not found or found[-1]["type"] != "ReplayDoneMessage":
        window = connection.recv(timeout=LIMIT)
        size = int.from_bytes(window[8:16], "little")
        text = zstandard.ZstdDecompressor().decompress(window[16 : 16 + size])
        found += msgspec.msgpack.decode(text)["messages"]
    return found


def send(socket, message):
    socket.send(msgspec.msgpack.encode(message))


def widget(messages, label):
    """Identifier of the widget with a label."""
    (uuid,) = (m["uuid"] for m in messages if m["type"].startswith("Gui") and m.get("props", {}).get("label") == label)
    return uuid


def odd_messages():
    """Invalid messages, and True if the planner must refuse them."""
    for index in (10**9, -(10**9), "3", None, 0.5):
        gone = index == 10**9  # a browser may still show a tag that was deleted
        yield not gone, [{**DRAGGED, "phase": "start", "instance_index": index}, {**DRAGGED, "phase": "end"}]
    for ray in ((NAN, 0, 0), (HUGE, -HUGE, HUGE)):
        yield False, [{**POINTED, "name": "/surfaces", "ray_direction": ray}]
        yield False, [{**DRAGGED, "phase": phase, "end_position": ray} for phase in ("start", "update", "end")]
    yield True, [{**POINTED, "name": "/surfaces", "ray_origin": "here"}]


def test_invalid_messages_do_no_harm(monkeypatch):
    said, saved = [], []

    def save(plan):
        saved.append(plan.deployment)
        raise Ended

    say = PlannerPanel.say

    def note(*args, refused=False):
        said.append(refused)
        say(*args, refused=refused)

    monkeypatch.setattr(PlannerPanel, "say", note)
    monkeypatch.setattr("lmd.planner.background.additions", lambda *_: None)
    session, planner = begun(save)
    before, mine = session.plan, urlsplit(planner.address)
    how = {"origin": f"http://{mine.netloc}", "subprotocols": [f"viser-v{viser.__version__}"], "max_size": None}
    open_socket = partial(connect, f"ws://{mine.netloc}{mine.path}", **how)
    with closing(planner):
        with open_socket() as socket:
            messages = shown_to(socket)
            send(socket, CAMERA)
            said.clear()
            refused = 0
            for is_refused, odd in odd_messages():
                refused += is_refused
                for message in odd:
                    send(socket, message)
            send(socket, {"type": "GuiUpdateMessage", "uuid": widget(messages, "Save"), "updates": {"value": True}})
            with pytest.raises(Ended):
                planner.run()
        assert saved[0] is before.deployment
        assert sum(said) == refused
        with open_socket() as socket:
            assert shown_to(socket)


def test_a_failure_of_background_work_is_shown(monkeypatch):
    def fail(*_):
        raise InputError("that is too big.")

    def say(_, text, refused=False):
        if refused:
            raise Ended(text)

    monkeypatch.setattr("lmd.planner.background.additions", fail)
    monkeypatch.setattr(PlannerPanel, "say", say)
    _, planner = begun(lambda _: "")
    with closing(planner), pytest.raises(Ended, match=r"^that is too big\.$"):
        planner.run()
