"""Draw the square whose edge is `tag.edge` in tags of several families: `python benchmarks/edges.py [FILE.svg]`."""

import sys
from pathlib import Path

from lmd.scene.families import FAMILIES, picture

FILE = Path(__file__).resolve().parents[1] / "docs" / "images" / "edges.svg"
SHOWN = ("36h11", "4x4_50", "41h12", "circle21h7")
SIDE, GAP, TEXT = 130.0, 40.0, 14.0  # edge of a picture, distance of pictures, height of letters, pixels


def drawn(family: str, left: float, top: float) -> str:
    """Tag 0 of a family, with the detected square and its edge in red."""
    shown, known = picture(family, 0), FAMILIES[family]
    module = SIDE / known.picture_modules
    black = "".join(
        f"M{left + j * module:.2f} {top + i * module:.2f}h{module:.2f}v{module:.2f}h{-module:.2f}z"
        for i, row in enumerate(shown)
        for j, white in enumerate(row)
        if not white
    )
    first, edge = left + known.around * module, known.modules * module
    below, middle = top + SIDE + 14.0, left + SIDE / 2.0
    return (
        f'<path d="{black}"/><g stroke="#d62728" stroke-width="2" fill="none">'
        f'<rect x="{first:.2f}" y="{top + known.around * module:.2f}" width="{edge:.2f}" height="{edge:.2f}"/>'
        f'<path d="M{first:.2f} {below:.0f}h{edge:.2f}m0 -6v12m{-edge:.2f} 0v-12"/></g>'
        f'<text x="{middle:.0f}" y="{below + 24:.0f}" font-weight="bold">{family}</text>'
        + "".join(
            f'<text x="{middle:.0f}" y="{below + 24 + TEXT * 1.3 * line:.0f}">{words}</text>'
            for line, words in enumerate(known.square.split(" inside "), 1)
        ).replace(">the ", ">inside the ")
    )


def main(path: Path) -> None:
    """Write the drawing."""
    width, height = len(SHOWN) * (SIDE + GAP) + GAP, GAP + SIDE + 14.0 + 24.0 + 3.0 * 1.3 * TEXT
    tags = "\n".join(drawn(family, GAP + k * (SIDE + GAP), GAP / 2.0) for k, family in enumerate(SHOWN))
    path.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" font-family="sans-serif" '
        f'font-size="{TEXT:.0f}" text-anchor="middle">\n<rect width="100%" height="100%" fill="white"/>\n'
        f"{tags}\n</svg>\n",
        encoding="utf-8",
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else FILE)
