"""Pages for the acceptance of a hung map: a plan of the stations, and a table with blank columns to fill in."""

import math
from pathlib import Path

import pandas as pd

from lmd.export.overview import ARROW, draw_arrow, draw_floor_plan, scale_of
from lmd.export.paper import PAPERS, document
from lmd.export.plan import HEAD, MARGIN, SCALES, Table, begin_titled, draw_tables
from lmd.formats.tag_map import TagMap

HEAD_ROW = ("no.", "zone", "x, m", "y", "z", "heading", "bound, m", "taped x", "y", "z", "reported x", "y", "z")
TABLE = Table((8.0, 13.0, 10.0, 10.0, 10.0, 14.0, 13.0, *6 * (13.0,)), (HEAD_ROW,), tuple(range(7, 13)))


def write_stations(path: Path, tags: TagMap, stations: pd.DataFrame) -> None:
    """Write a PDF for the acceptance of a hung map: a floor plan with the stations, and a table to fill in.

    A station is a pose in which the camera is placed. The camera's position is then measured by tape, and compared with
    the position that the robot's software reports.

    Args:
        path: path of the file.
        tags: the hung map.
        stations: table of the chosen stations, see `lmd.evaluation.acceptance.HungMap.chosen`.
    """
    size = PAPERS["a4"][::-1]
    scale = scale_of(tags.room, size[0] - 3.0 * MARGIN - TABLE.width, size[1] - 2.0 * MARGIN - HEAD, SCALES)
    facts = f"scale 1 : {scale}; headings clockwise from the y axis; in correct maps 95 % of errors are below the bound"
    with document(path, title := f"{len(stations)} stations") as canvas:
        begin_titled(canvas, size, title, facts)
        place = draw_floor_plan(canvas, tags, MARGIN, size[1] - MARGIN - HEAD, scale)
        places = place(stations[["x", "y"]].to_numpy()).tolist()
        for name, (x, y), yaw in zip(stations.station, places, stations.yaw_deg, strict=True):
            draw_arrow(canvas, x, y, ARROW, math.radians(90.0 - yaw), str(name))
        rows = stations[["station", "zone", "x", "y", "z", "yaw_deg", "bound"]].round(3).astype(str).to_numpy().tolist()
        draw_tables(canvas, size, TABLE, [[*row, *6 * ("",)] for row in rows], title, facts)
