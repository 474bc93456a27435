"""Pages that `lmd` writes, opened in a browser: no error on the console, no request beyond the file itself."""

import time

import chromium
import pytest
from services import mlflow_server, wait_until
from tracked import record_sweep, write_report

PATHS = ("pipelines/reproduction", "pipelines/operations/tracking")
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
