"""Files with poses that are not read as trajectories, each with the way to one that is."""

import re

from lmd.core.checks import InputError

AS_TEXT = "write a line per pose, time x y z qx qy qz qw, seconds and metres, from the camera to the world"
# By what the first lines hold.
UNREAD = (
    (
        r"^#\s*kapture format|^#?\s*timestamp,\s*device_id,\s*qw",
        "it is a trajectory of kapture, whose poses are world to camera, of several devices, and in data sets of "
        "different clocks: export it to COLMAP (kapture_export_colmap.py), whose images.txt is read, or " + AS_TEXT,
    ),
    (r"\A\s*(VERTEX|EDGE)_", "it is a pose graph of g2o, which has no times: " + AS_TEXT),
    (
        r"^header:\s*$",
        "it is a message that ROS prints as YAML: record it as CSV, by ros2 topic echo --csv TOPIC or rostopic echo -p "
        "TOPIC",
    ),
    (
        r"^VehicleName\s",
        "it is a recording of AirSim, in milliseconds, whose axes point north, east and down: write a table with "
        "time_ms,x,y,z,qw,qx,qy,qz from TimeStamp, POS_X, -POS_Y, -POS_Z, Q_W, Q_X, -Q_Y, -Q_Z, of a body",
    ),
    (r"\A\s*NVM_V3", "it is a model of VisualSFM: COLMAP's images.txt is read, or " + AS_TEXT),
    (r"\A\s*[{\[]", "it is JSON, and trajectories are read as text or CSV: " + AS_TEXT),
    (r"\A\s*<", "it is XML, and trajectories are read as text or CSV: " + AS_TEXT),
)
HEAD = 2000  # characters that tell


def check_kind(text: str) -> None:
    """Raise `InputError` if a text is of a kind that is known not to be a trajectory that is read."""
    for mark, sentence in UNREAD:
        if re.search(mark, text[:HEAD], re.MULTILINE):
            raise InputError(f"{sentence}.")
