"""Chromium without a window, for what `lmd` shows in browsers."""

import json
import shutil

import pytest

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
