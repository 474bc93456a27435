"""What the colours of the picture mean, with numbers, as HTML for the panel."""

import html

import numpy as np

from lmd.planner.colours import FREE, GAINS, PINNED, SEEN, SELECTED, UNKNOWN, VALUES, Rgb, mapped

COLOUR_STOPS = 9  # of a scale of colours
STYLE = "font-size: 0.75em; padding: 0 0.8em; white-space: nowrap; line-height: 1.4"
TAGS = {"free": FREE, "pinned": PINNED, "selected": SELECTED, "seen": SEEN}


def legend(value: str, most: float | None) -> str:
    """A table of the colours.

    Args:
        value: what positions are coloured by, from 0 to 1.
        most: what the brightest place of a surface adds; None while nothing is shown there.
    """
    rows = [f'<td colspan=2 style="white-space: normal">positions: {html.escape(value)}</td>']
    rows.append(f"<td></td><td>{_scale(VALUES, '0', '1')}</td>")
    if most is not None:
        rows.append(f"<td>a tag adds&ensp;</td><td>{_scale(GAINS, '0', f'+{most:.3%}')}</td>")
        rows.append(f"<td></td><td>{_square(UNKNOWN)} would overlap</td>")
    rows.append(f"<td>tags</td><td>{' '.join(f'{_square(colour)} {name}' for name, colour in TAGS.items())}</td>")
    return f'<table id="legend" style="{STYLE}">{"".join(f"<tr>{row}</tr>" for row in rows)}</table>'


def _scale(name: str, low: str, high: str) -> str:
    """A bar with the colours of a map, between what its ends mean."""
    colours = ", ".join(_css(tuple(colour)) for colour in mapped(name, np.linspace(0.0, 1.0, COLOUR_STOPS)).tolist())
    return f"{low} {_box('6em', f'linear-gradient(to right, {colours})')} {high}"


def _square(colour: Rgb) -> str:
    return _box("0.8em", _css(colour))


def _box(width: str, background: str) -> str:
    return f'<span style="display: inline-block; width: {width}; height: 0.8em; background: {background}"></span>'


def _css(colour: Rgb) -> str:
    return f"rgb{colour}"
