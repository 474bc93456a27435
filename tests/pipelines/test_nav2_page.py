"""The commands of docs/nav2.md: from a map of nav2 to tags in its frame."""

import math
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import shapely
import yaml
from support.processes import inside
from support.rooms import OCCUPIED, box, hall, write_map

from lmd.formats.tag_maps import read_deployment

PAGE = (Path(__file__).parents[2] / "docs" / "nav2.md").read_text(encoding="utf-8")
COMMANDS = [
    shlex.split(text) for text in re.findall(r"python -m pipelines\.(.*?)\n```", PAGE.replace("\\\n", ""), re.S)
]
QUICK = ["tracking=none", "validate=false", "threads=2"]
SMALL = {
    "evaluate": ["deployment.count=6", "room.spacing=2", *QUICK],
    "optimise": ["room.spacing=2", "budget.evaluations=2", "deployment.count=6", *QUICK],
    "export": ["tracking=none"],
}
CALIBRATION = {
    "image_width": 640,
    "image_height": 480,
    "camera_matrix": {"data": [553.8, 0.0, 321.4, 0.0, 554.1, 238.7, 0.0, 0.0, 1.0]},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"data": [-0.05, 0.02, 0.0, 0.0, 0.0]},
}
ORIGIN, YAW = np.array([-12.5, 3.75]), 0.3

pytestmark = pytest.mark.slow


def test_the_page_has_at_most_350_words():
    assert len(re.sub(r"```.*?```|\|.*\|", "", PAGE, flags=re.S).split()) <= 350


@pytest.mark.thorough(
    "docs/nav2.md",
    "lmd/export",
    "lmd/formats/plans.py",
    "lmd/space/free_region.py",
    "lmd/space/wall_lines.py",
    "lmd/formats/tag_map_writers.py",
)  # three quarters of a minute, most of it compiling
def test_the_commands_of_the_page_lead_to_tags_in_the_frame_of_the_map(tmp_path):
    """Half a minute where nothing is compiled yet, a few seconds otherwise."""
    grey = hall()
    box(grey, 2.0, 1.0, 2.6, 1.6, OCCUPIED)
    write_map(tmp_path, grey, origin=[*ORIGIN.tolist(), YAW])
    (tmp_path / "camera_info.yaml").write_text(yaml.safe_dump(CALIBRATION))
    assert [name for name, *_ in COMMANDS] == ["evaluate", "optimise", "export"]
    for name, *overrides in COMMANDS:
        asked = [override.replace("outputs/RUN", "optimise") for override in overrides]
        kept = [each for each in asked if each.partition("=")[0] not in {s.partition("=")[0] for s in SMALL[name]}]
        done = inside(name, *kept, *SMALL[name], f"hydra.run.dir={name}", cwd=tmp_path, settings=())
        assert done.returncode == 0, done.stderr
    for name in ("evaluate", "optimise"):
        assert (tmp_path / name / "room.png").stat().st_size > 5000
    turn = np.array([[math.cos(YAW), -math.sin(YAW)], [math.sin(YAW), math.cos(YAW)]])
    corners = np.array([[0, 0], [6, 0], [6, 4], [0, 4]]), np.array([[2, 1], [2.6, 1], [2.6, 1.6], [2, 1.6]])
    walls = shapely.Polygon(*[((at + 0.5) @ turn.T + ORIGIN).tolist() for at in corners[:1]]).boundary.union(
        shapely.Polygon((corners[1] + 0.5) @ turn.T + ORIGIN).boundary
    )
    planned = read_deployment(str(tmp_path / "optimise" / "landmarks.csv"))
    exported = read_deployment(str(tmp_path / "export" / "tags.ros2_tf.launch.py"))
    for found in (planned, exported):
        assert len(found) == 6
        assert shapely.distance(walls, shapely.points(found.positions[:, :2])).max() < 1e-3
        np.testing.assert_allclose(found.positions, planned.positions, atol=1e-3)
    assert {"plan.pdf", "sheets.pdf"} < {path.name for path in (tmp_path / "export").iterdir()}
