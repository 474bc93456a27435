"""Pages that `lmd` writes, opened in a browser: no error on the console, no request beyond the file itself."""

import io
import time

import chromium
import numpy as np
import pytest
from matplotlib.image import imread
from paper import paper_scene
from services import mlflow_server, wait_until
from tracked import record_sweep, write_report

from lmd.objectives.coverage import Coverage
from lmd.plot.page import save_scene_page
from lmd.problem import Problem
from lmd.scene.deployment_sources import UniformDeployment
from lmd.space.cuboid import Cuboid

PATHS = ("lmd/plot/page.py", "pipelines/reproduction", "pipelines/operations/tracking")
pytestmark = [pytest.mark.slow, pytest.mark.thorough(*PATHS), chromium.needs_chromium]


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    driver = chromium.start(tmp_path_factory.mktemp("profile"))
    yield driver
    driver.quit()


def visit(browser, path):
    """Open a file; what it wrote to the console as errors, and the addresses it asked for beside its own."""
    browser.get("about:blank")
    chromium.complaints(browser), chromium.requests(browser)
    browser.get(path.as_uri())
    time.sleep(1.0)  # for what a page does after it has loaded
    return chromium.complaints(browser), [url for url in chromium.requests(browser) if url != path.as_uri()]


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


def test_the_bare_address_of_the_ui_opens_the_training_runs(browser, tmp_path):
    uri = f"sqlite:///{tmp_path}/mlflow.db"
    record_sweep(uri, tmp_path, "landmark_count", [({"deployment.count": 30}, 0.3, "FINISHED")])
    with mlflow_server(uri, tmp_path, further=["--app-name", "lmd"]) as address:
        browser.get(address)
        wait_until(lambda: "/runs?workflowType=machine_learning" in browser.current_url)
        wait_until(lambda: "qualified_ratio" in browser.find_element("tag name", "body").text)
        browser.get(f"{address}/?a#/models")
        wait_until(lambda: "Models" in browser.find_element("tag name", "body").text)
        assert browser.current_url.endswith("#/models")


def test_errors_and_requests_are_noticed(browser, tmp_path):
    page = tmp_path / "bad.html"
    page.write_text("<script>undefined_function()</script><img src='http://127.0.0.1:9/picture.png'>")
    errors, asked = visit(browser, page)
    assert any("undefined_function" in message for message in errors)
    assert asked == ["http://127.0.0.1:9/picture.png"]
