"""Panel beside the picture, made of viser's widgets: metrics, buttons, sliders and the legend."""

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from lmd.core.compiled import is_compiling
from lmd.optimisers.ledger import Budget
from lmd.planner.plan import SearchProgress
from lmd.planner.viewing import FREE, GAINS, PINNED, SELECTED, UNKNOWN, VALUES, Rgb, mapped

HINT = "drag a tag; click a tag or a surface"
UNDO, REDO, PIN, DELETE, SAVE = "Undo", "Redo", "Pin or unpin", "Delete", "Save"
OFF_GRID_HEIGHT, TWO_LINES = "9em", "min-height: 2.8em"  # constant heights, so that the widgets below do not move
WIDTH, GAP = 290.0, 12.0  # width of the legend, and its distance from the lower left corner of the picture, pixels
OPTIMISE, STOP = "Optimise the free tags", "Stop, keep the best"
COLOUR_STOPS = 9  # number of colours in a scale of the legend
LEGEND_STYLE = "font-size: 0.75em; padding: 0 0.8em; white-space: nowrap; line-height: 1.4"
TAGS = {"free": FREE, "pinned": PINNED, "selected": SELECTED}


class PlannerPanel:
    """Widgets of the panel, and the texts that they show.

    Args:
        gui: GUI of a server of viser.
        value: name of the objective's value, which colours the camera positions.
        budget: initial budget of searches; users may change its limits.
        ids: True to show the ids of tags at first.
        edges: edge lengths that tags may have, metres.
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
            self.tag = gui.add_button_group("tag", (PIN, DELETE))
            self.step = gui.add_button_group("step", (UNDO, REDO))
            self.adds = gui.add_checkbox("a click on a surface adds a tag", initial_value=False)
            self._size = gui.add_dropdown("size", tuple(self._edges) or ("",), visible=len(self._edges) > 1)
        with gui.add_folder("Optimise"):
            # Limits are floats: for an integer, viser makes a widget that cannot receive fractions.
            self._limits = {
                name: gui.add_number(f"budget, {name}", float(limit), step=1.0)
                for name, limit in asdict(budget).items()
                if limit is not None
            }
            self.optimise = gui.add_button(OPTIMISE)
            self._bar = gui.add_progress_bar(0.0, visible=False)
            self._progress = gui.add_html("")
        with gui.add_folder("Show"):
            self.positions = gui.add_checkbox("positions", initial_value=True)
            self.names = gui.add_checkbox("names of surfaces", initial_value=True)
            self.ids = gui.add_checkbox("ids of tags", initial_value=ids)
            self.additions = gui.add_checkbox("what a tag adds", initial_value=True)
        colours = gui.add_panel()
        with colours.add_tab("Colours"):
            self._legend = gui.add_html("")
        colours.float(x=GAP, y=-GAP, width=WIDTH)
        self.say(HINT)
        self.show_tag("no tag is selected")
        self._span = (0.0, 1.0)
        self.show_legend(None)

    @property
    def budget(self) -> Budget:
        """Budget of the next search.

        Raises:
            InputError: a limit that the user has typed is not allowed.
        """
        return Budget(**{name: number.value for name, number in self._limits.items()})

    @property
    def edge(self) -> float | None:
        """Edge length that the user has chosen for new tags, metres; None if there is only one edge length, or if a
        browser sends an unknown value.
        """
        return self._edges.get(self._size.value) if len(self._edges) > 1 else None

    def show_figures(self, rows: Mapping[str, str]) -> None:
        """Show the metrics on the grid."""
        self._figures.content = _table("figures", rows)

    def show_off_grid(self, rows: Mapping[str, str]) -> None:
        """Show the metrics off the grid."""
        self._off_grid.content = f'<div style="min-height: {OFF_GRID_HEIGHT}">{_table("off-grid", rows)}</div>'

    def say(self, text: str, refused: bool = False) -> None:
        """Show a sentence in the panel; it is red if the user's request was refused."""
        colour = "#c92a2a" if refused else "inherit"
        self._message.content = _paragraph("message", text, f"color: {colour}; {TWO_LINES}")

    def say_addition(self, gain: float) -> None:
        """Show the gain by one more tag at a place; NaN if the new tag would overlap another tag."""
        self.say("a tag here would overlap another" if math.isnan(gain) else f"a tag here adds {gain:+.3%}")

    def show_tag(self, text: str) -> None:
        """Show the description of the selected tag."""
        self._tag.content = _paragraph("tag", text, TWO_LINES)

    def show_progress(self, progress: SearchProgress | None, running: bool) -> None:
        """Show the progress of a search, and the label of the button that starts or stops a search.

        `progress` is None if there is no search, or if the search has evaluated nothing yet.
        """
        self.optimise.label = STOP if running else OPTIMISE
        for number in self._limits.values():
            number.disabled = running
        self._bar.visible, self._bar.value = running, 100.0 * progress.used if progress else 0.0
        text = "compiling kernels, once" if running and is_compiling() else "begins" if running else ""
        if running and progress:
            limits = " or ".join(f"{number.value:g} {name}" for name, number in self._limits.items())
            text = f"{progress.used:.0%} of {limits}; best fitness {progress.fitness:.2%}"
        self._progress.content = _paragraph("progress", text)

    def show_span(self, span: tuple[float, float]) -> None:
        """Show in the legend that the colours of positions represent the objective's values from span[0] to span[1]."""
        self._span = span
        self.show_legend(self._most)

    def show_legend(self, most: float | None) -> None:
        """Show the legend of the colours.

        `most` is the gain that the brightest colour of surfaces represents; None if surfaces are grey.
        """
        self._most = most
        self._legend.content = _legend_html(self._value, self._span, most)


def _table(name: str, rows: Mapping[str, str]) -> str:
    cells = (f"<tr><td>{html.escape(key)}&emsp;</td><td>{html.escape(text)}</td></tr>" for key, text in rows.items())
    style = "font-size: 0.85em; padding: 0 1em; vertical-align: top"
    return f'<table id="{name}" style="{style}">{"".join(cells)}</table>'


def _paragraph(name: str, text: str, style: str = "") -> str:
    return f'<p id="{name}" style="font-size: 0.85em; margin: 0.4em 1em; {style}">{html.escape(text)}</p>'


def _legend_html(value: str, span: tuple[float, float], most: float | None) -> str:
    """Table in HTML that explains the colours.

    Args:
        value: name of the objective's value, which colours the camera positions.
        span: values, in [0, 1], that the first and the last colour of positions represent.
        most: gain that the brightest colour of surfaces represents; None while surfaces are grey.
    """
    rows = [f'<td colspan=2 style="white-space: normal">positions: {html.escape(value)}</td>']
    rows.append(f"<td></td><td>{_scale(VALUES, *(f'{end:.1%}' for end in span))}</td>")
    if most is not None:
        rows.append(f"<td>a tag adds&ensp;</td><td>{_scale(GAINS, '0', f'+{most:.3%}')}</td>")
        rows.append(f"<td></td><td>{_square(UNKNOWN)} would overlap</td>")
    rows.append(f"<td>tags</td><td>{' '.join(f'{_square(colour)} {name}' for name, colour in TAGS.items())}</td>")
    return f'<table id="legend" style="{LEGEND_STYLE}">{"".join(f"<tr>{row}</tr>" for row in rows)}</table>'


def _scale(name: str, low: str, high: str) -> str:
    """Bar in HTML with the colours of the colour map `name`, between the texts `low` and `high`."""
    colours = ", ".join(_css(tuple(colour)) for colour in mapped(name, np.linspace(0.0, 1.0, COLOUR_STOPS)).tolist())
    return f"{low} {_box('6em', f'linear-gradient(to right, {colours})')} {high}"


def _square(colour: Rgb) -> str:
    return _box("0.8em", _css(colour))


def _box(width: str, background: str) -> str:
    return f'<span style="display: inline-block; width: {width}; height: 0.8em; background: {background}"></span>'


def _css(colour: Rgb) -> str:
    return f"rgb{colour}"
