"""`pipelines.uncertainty` as a user meets it."""

import json

import numpy as np
import pandas as pd
import processes
import pytest
from PIL import Image

from lmd.adjust.gauge import SIGMA_COLUMNS
from lmd.formats.tag_maps import write_map_covariance

pytestmark = pytest.mark.slow
SETTINGS = ["experiment=lab", "tracking=none", "hydra.run.dir=run", "uncertainty.views=3000",
            "uncertainty.frames=40"]  # fmt: skip
FILES = {
    *("uncertainty.csv", "uncertainty_law.csv", "uncertainty_law.json", "uncertainty_tags.csv", "uncertainty.png"),
    *("VisionUncertainty.java", "vision_uncertainty.py", "robot_localization.yaml"),
}


def test_a_map_becomes_tables_laws_code_and_pictures(tmp_path):
    done = processes.inside("uncertainty", "deployment=uniform", "deployment.mounting_error=0.003", cwd=tmp_path,
                            settings=SETTINGS)  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert {path.name for path in (tmp_path / "run").iterdir() if path.is_file()} == FILES
    views = pd.read_csv(tmp_path / "run" / "uncertainty.csv", keep_default_na=True)
    assert list(views.columns[:14]) == [
        *("x", "y", "z", "yaw", "pitch", "roll", "tags", "distance"),
        *("sd_x", "sd_y", "sd_z", "sd_roll", "sd_pitch", "sd_yaw"),
    ]
    assert views.pose.value_counts().sum() == 3000
    document = json.loads((tmp_path / "run" / "uncertainty_law.json").read_text())
    assert document["views"]["share_one"] == pytest.approx((views.pose == "one").mean())
    assert set(document["deviation_over_rule"]["position"]) == {"law", "one law", "constant", "squared", "photonvision"}
    with Image.open(tmp_path / "run" / "uncertainty.png") as picture:
        assert picture.size[0] == 1700
    for words in ("with one pose", "corners     errors of aruco in 40 rendered images", "d^2 / n", "misleading"):
        assert words in done.stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            "deployment=uniform uncertainty.corners=mine",
            "uncertainty.corners must be one of auto, objective, rendered,",
        ),
        (
            "deployment=uniform uncertainty.corners=rendered visibility=paper",
            "uncertainty.corners = rendered needs a visibility model of a known detector",
        ),
        ("deployment=uniform uncertainty.shift=-1", "uncertainty.shift must be at least 0, got -1."),
        ("deployment=uniform uncertainty.views=10", "uncertainty.views: only "),
        ("deployment=uniform deployment.mounting_error=-1", "deployment.mounting_error.position must be at least 0"),
        (
            "deployment=file deployment.path=map.csv deployment.count=1 objective.n=1",
            "deployment.path: 'map.npz' is of another map than 'map.csv'",
        ),
        ("deployment=uniform visibility=paper tag.edge=null", "tag.edge must be given, in metres"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(tmp_path, words, message):
    sigmas = ",".join(SIGMA_COLUMNS)
    (tmp_path / "map.csv").write_text(f"id,x,y,z,nx,ny,nz,{sigmas}\n0,0,2,1.5,1,0,0{6 * ',1e-3'}\n")
    write_map_covariance(tmp_path / "map.npz", np.array([0]), 1e-8 * np.eye(6))
    settings = ["experiment=lab", "tracking=none", "hydra.run.dir=run"]
    processes.refused("uncertainty", *words.split(), message=message, cwd=tmp_path, settings=settings)
