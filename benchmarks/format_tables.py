"""The tables of formats in the documentation: `python benchmarks/format_tables.py [--update docs/mounting.md ...]`.

Prints the rows that the formats of `lmd.formats.registry` have; with `--update`, writes them between the marks of the
pages.
"""

import argparse
import re
from pathlib import Path

from lmd.formats.registry import rows

# The cells above the rows of each family.
HEADS = {
    "calibration": "calibration file | to know",
    "trajectory": "`poses.path` | content of a line",
    "tag map": "stack | `formats` | file | is [read](#maps-that-are-read), with the tag's size in",
    "room": "file | from",
    "floor plan": "file | from",
    "detections": "file | content",
}
# The arguments that the rows name, and their keys in the configuration.
KEYS = {
    "name": "camera.name",
    "image_size": "camera.image_size",
    "image_circle": "camera.image_circle",
    "distortion_model": "camera.distortion_model",
    "times": "poses.times",
    "rate": "poses.rate",
    "frame": "poses.frame",
    "columns": "poses.columns",
}
ARGUMENT = re.compile(rf"(?<=`)({'|'.join(KEYS)})(?=[=`])")


def table(family: str) -> str:
    """The table of a family, in Markdown."""
    head = HEADS[family]
    rule = " | ".join("---" for _ in head.split(" | "))
    text = "".join(f"| {cells} |\n" for cells in (head, rule, *rows(family)))
    keys = KEYS | ({"columns": "deployment.columns"} if family == "tag map" else {})
    return ARGUMENT.sub(lambda found: keys[found[0]], text)


def updated(page: str) -> str:
    """The text of a page with its tables as they should be; one without marks is left as it is."""
    for family in HEADS:
        begin, end = f"<!-- {family} formats -->", f"<!-- end of {family} formats -->"
        if begin in page:
            before, rest = page.split(begin)
            page = f"{before}{begin}\n\n{table(family)}\n{end}{rest.split(end)[1]}"
    return page


def main() -> None:
    """Print the tables, or write them to a page."""
    parser = argparse.ArgumentParser(description="Print the tables of formats, in Markdown.")
    parser.add_argument("--update", type=Path, metavar="PAGE", nargs="+", help="write the tables of these pages")
    pages = parser.parse_args().update
    for page in pages or ():
        page.write_text(updated(page.read_text(encoding="utf-8")), encoding="utf-8")
    if not pages:
        print("\n".join(map(table, HEADS)))


if __name__ == "__main__":
    main()
