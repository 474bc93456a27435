"""The panel beside the picture: figures, buttons and sliders, as viser has them."""

import html
import math
from collections.abc import Mapping
from typing import Any

from lmd.checks import IntArray
from lmd.planner.additions import Additions
from lmd.planner.search import Progress

ADDITIONS = {"mean value": "value", "fitness": "fitness"}  # what surfaces may show, and where `Additions` has it
NOTHING = "nothing"
HINT = "drag a tag; click a tag, a position or a surface"
UNDO, REDO, PIN, DELETE, SAVE = "Undo", "Redo", "Pin or unpin", "Delete", "Save"
OPTIMISE, STOP = "Optimise the free tags", "Stop, keep the best"


class Panel:
    """The widgets, and what they say.

    Args:
        gui: of a server of viser.
    """

    def __init__(self, gui: Any) -> None:
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        gui.set_panel_label("lmd")
        self._figures = gui.add_html("")
        self._off_grid = gui.add_html("")
        self._message = gui.add_html("")
        self.save = gui.add_button(SAVE)
        with gui.add_folder("Tags"):
            self._tag = gui.add_html("")
            self.tag = gui.add_button_group("tag", (PIN, DELETE))
            self.step = gui.add_button_group("step", (UNDO, REDO))
            self.adds = gui.add_checkbox("a click on a surface adds a tag", initial_value=False)
            self.optimise = gui.add_button(OPTIMISE)
            self._bar = gui.add_progress_bar(0.0, visible=False)
        with gui.add_folder("What the camera sees"):
            self._seen = gui.add_html("")
            self.yaw = gui.add_slider("yaw, degrees", -180.0, 180.0, 1.0, 0.0)
            self.pitch = gui.add_slider("pitch, degrees", -90.0, 90.0, 1.0, 0.0)
        with gui.add_folder("Show"):
            self.positions = gui.add_checkbox("positions", initial_value=True)
            self.additions = gui.add_dropdown("what a tag adds to", (*ADDITIONS, NOTHING))
            self._legend = gui.add_html("")
        self.say(HINT)
        self.show_tag(None)
        self.show_seen(None)

    @property
    def view(self) -> tuple[float, float]:
        """Yaw and pitch of the sliders, rad."""
        return math.radians(_within(self.yaw)), math.radians(_within(self.pitch))

    def show_figures(self, rows: Mapping[str, str]) -> None:
        """Show the figures on the grid."""
        self._figures.content = _table("figures", rows)

    def show_off_grid(self, rows: Mapping[str, str]) -> None:
        """Show the figures off the grid."""
        self._off_grid.content = _table("off-grid", rows)

    def say(self, text: str, refused: bool = False) -> None:
        """Show a sentence, in red if something was refused."""
        colour = "#c92a2a" if refused else "inherit"
        self._message.content = _paragraph("message", text, f"color: {colour}")

    def say_additions(self, found: Additions, index: int) -> None:
        """Say what a tag at one of the places would add."""
        gains = {name: float(getattr(found, key)[index]) for name, key in ADDITIONS.items()}
        if any(map(math.isnan, gains.values())):
            self.say("a tag here would overlap another")
        else:
            self.say(f"a tag here adds {', '.join(f'{gain:+.3%} to the {name}' for name, gain in gains.items())}")

    def show_tag(self, text: str | None) -> None:
        """Say which tag is selected; None for none."""
        self._tag.content = _paragraph("tag", text or "no tag is selected")

    def show_seen(self, ids: IntArray | None) -> None:
        """Say which tags the camera sees; None while it is nowhere."""
        if ids is None:
            self._seen.content = _paragraph("seen", "click a position to put the camera there")
            return
        listed = ", ".join(map(str, ids)) or "none"
        self._seen.content = _paragraph("seen", f"{len(ids)} in view: {listed}")

    def show_progress(self, progress: Progress | None, running: bool) -> None:
        """Show how far a search is, and what its button does."""
        self.optimise.label = STOP if running else OPTIMISE
        self._bar.visible, self._bar.value = running, 100.0 * progress.used if progress else 0.0
        if running and progress:
            self.say(f"optimising: best fitness {progress.fitness:.2%}")

    def show_legend(self, most: float | None) -> None:
        """Say what the brightest places of the surfaces mean; None while nothing is shown there."""
        self._legend.content = _paragraph("legend", "" if most is None else f"brightest on the surfaces: +{most:.3%}")


def _within(slider: Any) -> float:
    """The value of a slider, which is back at 0 if a browser has sent one that it cannot have."""
    if not slider.min <= slider.value <= slider.max:
        slider.value = 0.0
    return float(slider.value)


def _table(name: str, rows: Mapping[str, str]) -> str:
    cells = (f"<tr><td>{html.escape(key)}&emsp;</td><td>{html.escape(text)}</td></tr>" for key, text in rows.items())
    style = "font-size: 0.85em; padding: 0 1em; vertical-align: top"
    return f'<table id="{name}" style="{style}">{"".join(cells)}</table>'


def _paragraph(name: str, text: str, style: str = "") -> str:
    return f'<p id="{name}" style="font-size: 0.85em; margin: 0.4em 1em; {style}">{html.escape(text)}</p>'
