"""Measure how fast the planner answers a drag in the paper's room: `PYTHONPATH=.:tests python benchmarks/drag.py`.

First the session alone, one thread: a tag moves, all figures and the values of all positions are worked out. Then from
the message that a browser sends when the mouse moves to the one it gets with everything that is new. Then the whole way
in Chromium without a window, which draws on the processor: from the event of the mouse to the new figures in the page.
Prints two Markdown tables.
"""

import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import numpy as np
import viser
import zstandard
from hydra import compose, initialize_config_dir
from websockets import Origin, Subprotocol
from websockets.sync.client import connect

from lmd.pipelines.app import CONF
from lmd.pipelines.building import build_problem
from lmd.planner.background import ESTIMATE
from lmd.planner.session import PlanningSession

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from support import chromium
from support.chromium import Page
from support.processes import command, start

OBJECTIVES = {"paper": [], "robust": ["objective=robust"], "localisation": ["objective=localisation", "tag.edge=0.10"]}
DRAGS = 500
STEPS = 40  # number of mouse moves
# Notes when the mouse moves, and when the place of the tag and the figures that are shown change.
WATCH = """
window.moved = []; window.shown = [];
const shown = () => document.getElementById("figures").innerText + document.getElementById("tag").innerText;
let last = shown();
window.addEventListener("pointermove", () => window.moved.push(performance.now()), true);
new MutationObserver(() => {
  if (shown() !== last) { last = shown(); window.shown.push(performance.now()); }
}).observe(document.body, {childList: true, subtree: true, characterData: true});
"""


def session_times(overrides: list[str]) -> np.ndarray:
    """Milliseconds of drags, `(DRAGS,)`."""
    with initialize_config_dir(CONF, version_base="1.3"):
        problem = build_problem(compose("evaluate", [*overrides, "threads=1"]))
    rng, session = np.random.default_rng(0), PlanningSession(problem, problem.draw(np.random.default_rng(0)))
    session.warm_up()
    surfaces, times = problem.scene.footprints.hanging.surfaces(), []
    for _ in range(DRAGS):
        number, surface = int(rng.integers(len(session.deployment))), int(rng.integers(len(surfaces)))
        place = rng.uniform(size=2) * surfaces[surface].extent
        began = time.perf_counter()
        session.drag(number, surface, place)
        session.metrics(), session.values()
        times.append(time.perf_counter() - began)
    return 1e3 * np.array(times)


@contextmanager
def planner() -> Iterator[tuple[str, Path]]:
    """The address of a running planner with tag 0 at (2, 5, 1), and a folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rows = "".join(f"{k},{0.05 + 7.4 * k / 89},0,5.5,0,1,0\n" for k in range(1, 90))
        (folder / "tags.csv").write_text(f"id,x,y,z,nx,ny,nz\n0,2,5,1,0,-1,0\n{rows}")
        overrides = ("deployment=file", "deployment.path=tags.csv", "hydra.run.dir=run")
        process = start(command("view", *overrides, settings=()), cwd=folder, stdout=subprocess.PIPE)
        try:
            yield re.findall(r"http\S+", process.stdout.readline())[0], folder
        finally:
            process.terminate()
            process.wait()


def message_times(address: str) -> np.ndarray:
    """Milliseconds from messages of drags to their answers, `(STEPS,)`."""
    camera = {
        "wxyz": (1, 0, 0, 0), "position": (3, -6, 3), "fov": 1.3, "near": 0.01, "far": 100, "image_height": 800,
        "image_width": 1200, "look_at": (3, 2, 3), "up_direction": (0, 0, 1),
    }  # fmt: skip
    drag = {
        "name": "/tags", "instance_index": 0, "start_position": (2, 5, 1), "start_screen_pos": (0, 0),
        "end_screen_pos": (0, 0), "button": "left", "modifier": None,
    }  # fmt: skip
    protocol, url = Subprotocol(f"viser-v{viser.__version__}"), address.replace("http", "ws")
    origin, times = Origin("/".join(address.split("/")[:3])), []
    with connect(url, origin=origin, subprotocols=[protocol], max_size=None, compression=None) as socket:

        def send(**message: object) -> None:
            socket.send(msgspec.msgpack.encode(message))

        def wait_for(text: bytes, but: bytes | None = None) -> None:
            while text not in (messages := _unpacked(socket.recv())) or (but is not None and but in messages):
                pass

        send(type="ViewerCameraMessage", **camera)
        wait_for(b"on a finer grid", but=next(iter(ESTIMATE)).encode())  # then nothing else is worked out
        for step in range(STEPS + 1):
            time.sleep(0.1)
            began = time.perf_counter()
            place = (2.0 + 3.0 * step / STEPS, 5.0, 1.0)
            send(type="SceneNodeDragMessage", phase="update" if step else "start", end_position=place, **drag)
            wait_for(b'"tag"')
            times.append(time.perf_counter() - began)
    return 1e3 * np.array(times[1:])


def _unpacked(window: bytes) -> bytes:
    """The messages of viser in what comes over a socket, without its arrays: two sizes and a compressed part."""
    size = int.from_bytes(window[8:16], "little")
    return zstandard.ZstdDecompressor().decompress(window[16 : 16 + size])


def browser_times(address: str, folder: Path) -> np.ndarray:
    """Milliseconds from moves of the mouse to what they lead to."""
    driver = chromium.start(folder / "profile")
    try:
        page = Page(driver, address)
        page.browser.execute_script(WATCH)
        page.mouse(*((2.0 + 3.0 * step / STEPS, 5.0, 1.0) for step in range(STEPS + 1)), pause=0.4)
        time.sleep(2.0)
        moved, shown = (np.array(page.script(f"window.{name}")) for name in ("moved", "shown"))
    finally:
        driver.quit()
    after = np.searchsorted(shown, moved)
    answered = after < len(shown)
    times = shown[after[answered]] - moved[answered]
    return times[times < 400.0]  # the others are of moves that nothing follows from: less than the mouse must move


def main() -> None:
    """Print the tables."""

    def row(name: str, times: np.ndarray) -> str:
        figures = (np.median(times), np.percentile(times, 95), times.max())
        return f"| {name} | {len(times)} | {' | '.join(f'{ms:.2f}' for ms in figures)} |"

    head = "drags | median, ms | 95 % below, ms | most, ms |\n| --- | --- | --- | --- | --- |"
    print(f"| session, objective | {head}")
    for name, overrides in OBJECTIVES.items():
        print(row(name, session_times(overrides)), flush=True)
    print(f"\n| the whole way | {head}")
    with planner() as (address, _):
        print(row("without a browser: from message to message", message_times(address)), flush=True)
    with planner() as (address, folder):
        print(row("Chromium, drawing on the processor: from the mouse to the page", browser_times(address, folder)))


if __name__ == "__main__":
    main()
