"""`pipelines.view` as a user meets it: a process, and a page in Chromium that is dragged on with the mouse."""

import signal
import socket
import subprocess
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from urllib.parse import urlsplit

import numpy as np
import pytest
from support import chromium
from support.chromium import LANDMARKS, LIMIT, SETTINGS, Page
from support.processes import call, command, refused, start

from lmd.scene.deployment import Deployment

pytestmark = [pytest.mark.slow, pytest.mark.long]
THOROUGH = pytest.mark.thorough("lmd/planner", "pipelines/view.py")

OVERRIDES = ("deployment.path=mine.csv", "hydra.run.dir=out")
ENDLESS = "budget.evaluations=100000000"  # searches go on until they are stopped
EXPORTED = {"tags.csv", "tags.json", "tags.wpilib.json", "plan.pdf", "sheets.pdf"}
ADDS, BALLS = "a click on a surface adds a tag", "positions"


@pytest.fixture
def work(tmp_path):
    (tmp_path / "mine.csv").write_text(LANDMARKS)
    return tmp_path


@contextmanager
def running(work, *overrides):
    """A running planner, and its address."""
    line = command("view", *OVERRIDES, ENDLESS, *overrides, settings=SETTINGS)
    process = start(line, cwd=work, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    yield process, process.stdout.readline().split()[1]
    process.kill()
    process.communicate()


@pytest.fixture
def planner(work):
    with running(work) as started:
        yield started


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    driver = chromium.start(tmp_path_factory.mktemp("profile"))
    chromium.draw_little(driver)
    yield driver
    driver.quit()


@pytest.fixture
def site(tmp_path):
    """The port of another site on this machine."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(SimpleHTTPRequestHandler, directory=tmp_path)) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield server.server_port
        server.shutdown()


@THOROUGH
@chromium.needs_chromium
def test_a_tag_is_dragged_and_saved_and_the_figures_are_those_of_evaluate(planner, browser, work):
    process, address = planner
    page = Page(browser, address)
    before = page.rows("figures")
    page.tick(BALLS)  # nothing is in the mouse's way
    page.mouse((2.0, 5.0, 1.0), (2.3, 5.0, 1.5), (3.0, 5.0, 2.5))
    page.until(lambda: page.rows("figures") != before)
    assert "tag 7: y_max, (" in page.text("tag")
    page.until(page.is_settled)
    shown = page.rows("figures") | page.rows("off-grid")
    page.press("Save")
    page.until(lambda: page.text("message").startswith("saved in "))
    assert {path.name for path in (work / "out").iterdir()} > {"landmarks.csv", *EXPORTED}

    saved, first = (Deployment.from_csv(path) for path in (work / "out" / "landmarks.csv", work / "mine.csv"))
    assert np.linalg.norm(saved.positions[0] - (3.0, 5.0, 2.5)) < 0.1
    assert saved.positions[0, 1] == 5.0
    assert (saved.positions[1:] == first.positions[1:]).all()
    assert saved.ids.tolist() == [7, 3, 9, 4]
    assert saved.labels.columns["note"][0] == "by the door"

    quick = ("localisation=false", "losses=false", "picture=false")
    done = call("evaluate", "run=out", "tracking=none", cwd=work, settings=quick)
    assert done.returncode == 0, done.stderr
    said = {key: line[len(key) :].strip() for line in done.stdout.splitlines() for key in shown if line.startswith(key)}
    assert shown.pop("since opened").endswith(" points of fitness")
    assert said == shown
    assert page.complaints() == []
    assert set(chromium.requests(browser)) == {address}

    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=LIMIT)
    assert process.returncode == 128 + signal.SIGINT
    assert "not saved" not in err


@THOROUGH
@chromium.needs_chromium
def test_a_page_of_another_site_cannot_talk_to_it_whatever_it_knows(planner, browser, site):
    _, address = planner
    page = Page(browser, address)
    assert page.connects_to(address)
    browser.refresh()
    page.until(lambda: page.rows("figures"))
    for origin in (f"http://{chromium.FOREIGN}:{site}", f"http://127.0.0.1:{site}"):
        browser.get(origin)
        assert page.script("window.origin") == origin
        assert not page.connects_to(address)
    mine = urlsplit(address)
    browser.get(f"http://{chromium.FOREIGN}:{mine.port}{mine.path}")  # as if its name meant this machine
    assert page.script("document.body.innerText").strip() == "The planner talks to no page but its own."
    assert not page.connects_to(address.replace("127.0.0.1", chromium.FOREIGN))


def test_a_port_that_is_taken_is_refused(work):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        refused("view", *OVERRIDES, f"port={port}", message=f"port {port} is in use.", cwd=work, settings=SETTINGS)
