"""What the colours of the picture mean, with numbers, as HTML for the panel."""

import html

import numpy as np

from lmd.planner.colours import FREE, GAINS, PINNED, SEEN, SELECTED, UNKNOWN, VALUES, Rgb, mapped

STOPS = 9  # of a scale of colours
TAGS = {"free": FREE, "pinned": PINNED, "selected": SELECTED, "seen": SEEN}


def legend(value: str, most: float | None) -> str:
    """A table of the colours.

    Args:
        value: what positions are coloured by, from 0 to 1.
        most: what the brightest place of a surface adds; None while nothing is shown there.
    """
    rows = [("positions", _scale(VALUES, "0", "1")), ("", html.escape(value))]
    if most is not None:
        rows += [("a tag adds", _scale(GAINS, "0", f"+{most:.3%}")), ("a tag overlaps", _square(UNKNOWN))]
    rows.append(("tags", " ".join(f"{_square(colour)} {name}" for name, colour in TAGS.items())))
    cells = (f"<tr><td>{head}&emsp;</td><td>{cell}</td></tr>" for head, cell in rows)
    return f'<table id="legend" style="font-size: 0.85em; padding: 0 1em">{"".join(cells)}</table>'


def _scale(name: str, low: str, high: str) -> str:
    """A bar with the colours of a map, between what its ends mean."""
    colours = ", ".join(_css(tuple(colour)) for colour in mapped(name, np.linspace(0.0, 1.0, STOPS)).tolist())
    return f"{low} {_box('6em', f'linear-gradient(to right, {colours})')} {high}"


def _square(colour: Rgb) -> str:
    return _box("0.8em", _css(colour))


def _box(width: str, background: str) -> str:
    return f'<span style="display: inline-block; width: {width}; height: 0.8em; background: {background}"></span>'


def _css(colour: Rgb) -> str:
    return f"rgb{colour}"
