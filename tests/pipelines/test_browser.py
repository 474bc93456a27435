"""What `lmd` writes for browsers, opened in one: no error on the console, no request beyond the file itself."""

import io
import json
import shutil
import time

import numpy as np
import pytest
from matplotlib.image import imread
from paper import paper_scene
from tracked import record_sweep, write_report

from lmd.deployment import UniformDeployment
from lmd.objectives.coverage import Coverage
from lmd.plot.page import save_scene_page
from lmd.problem import Problem
from lmd.space.cuboid import Cuboid

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
DRIVER = shutil.which("chromedriver")
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
)
REASON = "needs Chromium and its driver (Debian: apt-get install chromium chromium-driver)"
pytestmark = [pytest.mark.slow, pytest.mark.skipif(not (CHROMIUM and DRIVER), reason=REASON)]


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(executable_path=DRIVER))
    driver.set_page_load_timeout(120)
    yield driver
    driver.quit()


def visit(browser, path):
    """Open a file; what it wrote to the console as errors, and the addresses it asked for beside its own."""
    browser.get("about:blank")
    browser.get_log("browser"), browser.get_log("performance")
    browser.get(path.as_uri())
    time.sleep(1.0)  # for what a page does after it has loaded
    errors = [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
    return errors, [url for url in asked if url != path.as_uri() and not url.startswith(("data:", "blob:"))]


def test_the_interactive_page_of_a_scene(browser, tmp_path):
    room = Cuboid(size=(3.0, 2.0, 2.5), reachable_size=(2.0, 1.0, 1.5), spacing=0.8)
    problem = Problem(paper_scene(room), Coverage(2, 0.65), UniformDeployment(7), threads=1)
    deployment = problem.start.draw(room, np.random.default_rng(0))
    page = tmp_path / "scene.html"
    save_scene_page(page, problem, deployment, "The scene")
    assert visit(browser, page) == ([], [])
    assert browser.title == "The scene"
    assert browser.execute_script("return document.querySelectorAll('.gl-container canvas').length") > 0
    shown = imread(io.BytesIO(browser.get_screenshot_as_png()))[..., :3]
    landmarks = (np.abs(shown - [214 / 255, 39 / 255, 40 / 255]) < 0.1).all(axis=-1)
    assert landmarks.sum() > 50  # drawn, not only there


def test_the_report(browser, tmp_path):
    uri = f"sqlite:///{tmp_path}/mlflow.db"
    record_sweep(uri, tmp_path, "landmark_count", [({"deployment.count": k}, k / 100, "FINISHED") for k in (30, 90)])
    write_report(tmp_path / "report", f"tracking.uri={uri}")
    assert visit(browser, tmp_path / "report" / "report.html") == ([], [])
    assert browser.title == "The paper's tables and figures, reproduced"
    assert browser.execute_script("return document.querySelectorAll('td').length") == 6
    assert browser.execute_script("return Array.from(document.images, image => image.naturalWidth)") == [800]


def test_errors_and_requests_are_noticed(browser, tmp_path):
    page = tmp_path / "bad.html"
    page.write_text("<script>undefined_function()</script><img src='http://127.0.0.1:9/picture.png'>")
    errors, asked = visit(browser, page)
    assert any("undefined_function" in message for message in errors)
    assert asked == ["http://127.0.0.1:9/picture.png"]
