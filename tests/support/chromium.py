"""Chromium without a window, and the interactive planner in it."""

import json
import shutil
import time

import numpy as np
import pytest
import viser
from selenium.webdriver.common.actions.action_builder import ActionBuilder

from lmd.planner.background import ESTIMATE
from lmd.planner.viewing import FIELD_OF_VIEW, framed
from support.paper import paper_room
from support.processes import SMALL

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
DRIVER = shutil.which("chromedriver")
FOREIGN = "foreign.example"
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",  # WebGL on the processor
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--window-size=1400,900",
    f"--host-resolver-rules=MAP {FOREIGN} 127.0.0.1",  # as its owner may have names servers say
)
FRAMES = """
requestAnimationFrame = draw => setTimeout(() => draw(performance.now()), 250);
cancelAnimationFrame = clearTimeout;
"""
REASON = "needs Chromium and its driver (Debian: apt-get install chromium chromium-driver)"
needs_chromium = pytest.mark.skipif(not (CHROMIUM and DRIVER), reason=REASON)


def start(profile):
    """A driver of selenium; `profile` is an empty folder."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(executable_path=DRIVER))
    driver.set_page_load_timeout(120)
    return driver


def draw_little(driver):
    """Let pages that never stop drawing do it four times a second, in a small window: the processor does it all."""
    driver.set_window_size(1000, 640)
    driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": FRAMES})


def complaints(driver):
    """Errors that pages have written to the console since the last call."""
    return [entry["message"] for entry in driver.get_log("browser") if entry["level"] == "SEVERE"]


def requests(driver):
    """The addresses that were asked for since this was asked last."""
    events = [json.loads(entry["message"])["message"] for entry in driver.get_log("performance")]
    asked = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
    return [url for url in asked if not url.startswith(("data:", "blob:", "chrome:"))]


LIMIT = 300.0  # seconds
OF_VISERS = "Unable to preventDefault inside passive event listener"  # error that viser's own page logs on every drag


class Page:
    """The planner in a browser."""

    def __init__(self, browser, address):
        self.browser = browser
        browser.get("about:blank")
        complaints(browser), requests(browser)
        browser.get(address)
        self.until(self.is_settled)

    def script(self, text, *arguments):
        return self.browser.execute_script(f"return {text}", *arguments)

    def connects_to(self, address):
        """Return whether the open page can open a websocket to a planner."""
        return self.browser.execute_async_script(
            """const [address, protocol, done] = arguments, socket = new WebSocket(address, [protocol]);
            socket.onopen = () => done(true); socket.onclose = () => done(false);""",
            address.rstrip("/").replace("http", "ws", 1),
            f"viser-v{viser.__version__}",
        )

    def complaints(self):
        return [message for message in complaints(self.browser) if OF_VISERS not in message]

    def until(self, is_so):
        began = time.monotonic()
        while not is_so():
            assert time.monotonic() - began < LIMIT, self.script("document.body.innerText")
            time.sleep(0.3)

    def is_settled(self):
        """Return whether no computation is running."""
        rows = self.rows("off-grid")
        return rows.keys() > {"off the grid"} and not rows.keys() & ESTIMATE.keys()

    def text(self, name):
        return self.script("document.getElementById(arguments[0])?.innerText ?? ''", name).strip()

    def rows(self, name):
        found = self.script(
            "Array.from(document.querySelectorAll(`#${arguments[0]} tr`), r => Array.from(r.cells, c => c.innerText))",
            name,
        )
        return {key.strip(): text.strip() for key, text in found}

    def buttons(self):
        return self.script("Array.from(document.querySelectorAll('button')).map(b => b.innerText)")

    def press(self, label):
        self.until(lambda: label in self.buttons())
        self.script("document.querySelectorAll('button')[arguments[0]].click()", self.buttons().index(label))

    def tick(self, label):
        labels = self.script("Array.from(document.querySelectorAll('label'), l => [l.innerText, l.htmlFor])")
        self.script("document.getElementById(arguments[0]).click()", dict(labels)[label])
        time.sleep(1.0)  # the page tells of that some time later, but of a click in the picture at once

    def pixel(self, point):
        """Pixel at which a point of the room is shown."""
        left, top, width, height = self.script(
            "(r => [r.left, r.top, r.width, r.height])(document.querySelector('canvas').getBoundingClientRect())"
        )
        position, look_at = framed(*paper_room().bounds(), width / height)
        ahead = (look_at - position) / np.linalg.norm(look_at - position)
        right = np.cross(ahead, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(ahead, [0.0, 0.0, 1.0]))
        offset = np.array(point) - position
        x, y, z = offset @ right, offset @ np.cross(right, ahead), offset @ ahead
        scale = height / 2.0 / np.tan(FIELD_OF_VIEW / 2.0) / z
        return round(left + width / 2.0 + scale * x), round(top + height / 2.0 - scale * y)

    def mouse(self, *places, pause=0.1):
        """Press the mouse at the first place, and release it at the last."""
        actions = ActionBuilder(self.browser, duration=50)
        first, *others = (self.pixel(place) for place in places)
        actions.pointer_action.move_to_location(*first).pause(0.3).pointer_down()
        for place in others:
            actions.pointer_action.move_to_location(*place).pause(pause)
        actions.pointer_action.pointer_up()
        actions.perform()


LANDMARKS = """id,x,y,z,nx,ny,nz,note
7,2,5,1,0,-1,0,by the door
3,5,5,1,0,-1,0,
9,0,1,3,1,0,0,
4,3,5,5,0,-1,0,
"""
SETTINGS = (*SMALL[:2], "tag.edge=0.15", "objective.n=1", "objective.thold_p=0.1", "deployment=file")
UNSAVED = "unsaved.csv"
