"""The panel beside the picture: figures, buttons and sliders, as viser has them."""

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from lmd.core.checks import IntArray
from lmd.core.compiled import is_compiling
from lmd.optimisers.ledger import Budget
from lmd.planner.acts import in_order
from lmd.planner.additions import Additions
from lmd.planner.legend import legend
from lmd.planner.plan import Measured
from lmd.planner.search import Progress

ADDITIONS = {"mean value": "value", "fitness": "fitness"}  # what surfaces may show, and where `Additions` has it
NO_ADDITION = "nothing"
HINT = "drag a tag; click a tag, a position or a surface"
UNDO, REDO, PIN, DELETE, SAVE = "Undo", "Redo", "Pin or unpin", "Delete", "Save"
RESIZE = "Give the tag this size"
PLACE, FROM_FLOOR, FROM_BELOW = "Hang it there", "from floor, m", "from below, m"
WIDTH, GAP = 290.0, 12.0  # of the legend, and from it to the lower left corner of the picture, pixels
OPTIMISE, STOP = "Optimise the free tags", "Stop, keep the best"


class Panel:
    """The widgets, and what they say.

    Args:
        gui: of a server of viser.
        value: what positions are coloured by.
        budget: of searches at first; users may change what limits it.
        ids: whether those of tags are shown at first.
        edges: that tags may have, metres.
    """

    def __init__(self, gui: Any, value: str, budget: Budget, ids: bool, edges: Sequence[float] = ()) -> None:
        self._value, self._edges = value, dict(zip(map("{:g} m".format, edges), edges, strict=True))
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        gui.set_panel_label("lmd")
        gui.main_panel.dock_right()
        self._figures = gui.add_html("")
        self._off_grid = gui.add_html("")
        self._message = gui.add_html("")
        self.save = gui.add_button(SAVE)
        with gui.add_folder("Tags"):
            self._tag = gui.add_html("")
            self._left = gui.add_number("from left, m", 0.0, step=0.001)
            self._up = gui.add_number(FROM_FLOOR, 0.0, step=0.001)
            self.place = gui.add_button(PLACE)
            self.tag = gui.add_button_group("tag", (PIN, DELETE))
            self.step = gui.add_button_group("step", (UNDO, REDO))
            self.adds = gui.add_checkbox("a click on a surface adds a tag", initial_value=False)
            self._size = gui.add_dropdown("size", tuple(self._edges) or ("",), visible=len(self._edges) > 1)
            self.resize = gui.add_button(RESIZE, visible=len(self._edges) > 1)
        with gui.add_folder("Optimise"):
            # Numbers with a fraction: of one without, viser makes one that no browser could be told.
            self._limits = {
                name: gui.add_number(f"budget, {name}", float(limit), step=1.0)
                for name, limit in asdict(budget).items()
                if limit is not None
            }
            self.optimise = gui.add_button(OPTIMISE)
            self._bar = gui.add_progress_bar(0.0, visible=False)
            self._progress = gui.add_html("")
        with gui.add_folder("What the camera sees"):
            self._seen = gui.add_html("")
            self.yaw = gui.add_slider("yaw, degrees", -180.0, 180.0, 1.0, 0.0)
            self.pitch = gui.add_slider("pitch, degrees", -90.0, 90.0, 1.0, 0.0)
            for slider in (self.yaw, self.pitch):
                # In viser's thread, or it may tell browsers of a value after it was put back.
                in_order(slider.on_update, _put_back)
        with gui.add_folder("Show"):
            self.positions = gui.add_checkbox("positions", initial_value=True)
            self.names = gui.add_checkbox("names of surfaces", initial_value=True)
            self.ids = gui.add_checkbox("ids of tags", initial_value=ids)
            self.additions = gui.add_dropdown("what a tag adds to", (*ADDITIONS, NO_ADDITION))
        colours = gui.add_panel()
        with colours.add_tab("Colours"):
            self._legend = gui.add_html("")
        colours.float(x=GAP, y=-GAP, width=WIDTH)
        self.say(HINT)
        self.show_tag(None, None)
        self.show_legend(None)
        self.show_seen(None)

    @property
    def view(self) -> tuple[float, float]:
        """Yaw and pitch of the sliders, rad."""
        return math.radians(_within(self.yaw)), math.radians(_within(self.pitch))

    @property
    def budget(self) -> Budget:
        """What the next search may spend.

        Raises:
            InputError: a limit that was typed makes no sense.
        """
        return Budget(**{name: number.value for name, number in self._limits.items()})

    @property
    def edge(self) -> float | None:
        """The size that is chosen, metres; None where there is no choice, and what a browser made up."""
        return self._edges.get(self._size.value) if len(self._edges) > 1 else None

    @property
    def typed(self) -> tuple[float, float]:
        """The place that was typed, see `Measured`: from the left, and up."""
        return float(self._left.value), float(self._up.value)

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

    def show_tag(self, text: str | None, measured: Measured | None) -> None:
        """Say which tag is selected and where it hangs; None for none, and for one that hangs on no surface."""
        self._tag.content = _paragraph("tag", text or "no tag is selected")
        if measured is not None:
            self._left.value, self._up.value = round(measured.left, 4), round(measured.up, 4)
            self._up.label = FROM_FLOOR if measured.from_floor else FROM_BELOW
        for widget in (self._left, self._up, self.place):
            widget.disabled = measured is None

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
        for number in self._limits.values():
            number.disabled = running
        self._bar.visible, self._bar.value = running, 100.0 * progress.used if progress else 0.0
        text = "compiling what this needs, once" if running and is_compiling() else "begins" if running else ""
        if running and progress:
            limits = " or ".join(f"{number.value:g} {name}" for name, number in self._limits.items())
            text = f"{progress.used:.0%} of {limits}; best fitness {progress.fitness:.2%}"
        self._progress.content = _paragraph("progress", text)

    def show_legend(self, most: float | None) -> None:
        """Say what colours mean; `most` is what the brightest surface means, None while nothing is shown there."""
        self._legend.content = legend(self._value, most)


def _within(slider: Any) -> float:
    """The value of a slider, 0 where a browser has just sent one that it cannot have."""
    value = float(slider.value)
    return value if slider.min <= value <= slider.max else 0.0


def _put_back(event: Any) -> None:
    """Put a slider back to 0 if a browser has sent a value that it cannot have."""
    event.target.value = _within(event.target)


def _table(name: str, rows: Mapping[str, str]) -> str:
    cells = (f"<tr><td>{html.escape(key)}&emsp;</td><td>{html.escape(text)}</td></tr>" for key, text in rows.items())
    style = "font-size: 0.85em; padding: 0 1em; vertical-align: top"
    return f'<table id="{name}" style="{style}">{"".join(cells)}</table>'


def _paragraph(name: str, text: str, style: str = "") -> str:
    return f'<p id="{name}" style="font-size: 0.85em; margin: 0.4em 1em; {style}">{html.escape(text)}</p>'
