"""`pipelines.accuracy`, and `pipelines.evaluate` with `sensitivity=true`, as a user meets them."""

import json
import re

import pandas as pd
import processes
import pytest
from mlflow import MlflowClient
from PIL import Image

pytestmark = pytest.mark.slow
LANDMARKS = "id,x,y,z,nx,ny,nz\n0,0,2,3,1,0,0\n1,0,3,3,1,0,0\n2,7.5,2,3,-1,0,0\n"
SMALL = ["room.spacing=1.5", "hydra.run.dir=run"]
TABLES = ["assumptions", "misses", "tags", "lost"]


def metrics_of(cwd, experiment="lmd accuracy"):
    client = MlflowClient(tracking_uri=f"sqlite:///{cwd}/outputs/mlflow.db")
    (run,) = client.search_runs([client.get_experiment_by_name(experiment).experiment_id])
    assert run.info.status == "FINISHED"
    return run.data.metrics, {file.path for file in client.list_artifacts(run.info.run_id)}


def test_evaluate_measures_what_the_figures_hang_on(tmp_path):
    (tmp_path / "mine.csv").write_text(LANDMARKS)
    done = processes.inside("evaluate", "sensitivity=true", "deployment=file", "deployment.path=mine.csv",
                          "tag.edge=0.8", "validate=false", "localisation=false", cwd=tmp_path,
                          settings=SMALL)  # fmt: skip
    assert done.returncode == 0, done.stderr
    tables = {name: pd.read_csv(tmp_path / "run" / f"{name}.csv") for name in TABLES}
    assert tables["tags"].id.tolist() == [0, 1, 2]
    overlapping = tables["assumptions"].query("assumption == 'edge' and factor > 1")
    assert overlapping.note.str.contains("landmarks 0 and 1 on x_min overlap").all()
    assert overlapping.localised_share.isna().all()
    written = json.loads((tmp_path / "run" / "metrics.json").read_text())["sensitivity"]
    logged, artifacts = metrics_of(tmp_path, "lmd")
    assert {*(f"{name}.csv" for name in TABLES), "sensitivity.png"} <= artifacts
    assert {key: logged[f"sensitivity/{key}"] for key in written} == written
    assert written["missed_0.1/covered_share"] == pytest.approx(tables["misses"].covered_share[2])
    for words in ("missed 0.05", "worst ids", "pixel noise", "edge x 2: landmarks 0 and 1 on x_min overlap"):
        assert words in done.stdout


def test_accuracy_sets_deployments_side_by_side(tmp_path):
    (tmp_path / "mine.csv").write_text(LANDMARKS)
    done = processes.inside("accuracy", "deployments=[uniform,'mine: file deployment.path=mine.csv']", cwd=tmp_path,
                          settings=SMALL)  # fmt: skip
    assert done.returncode == 0, done.stderr
    figures = pd.read_csv(tmp_path / "run" / "figures.csv", index_col="deployment")
    assert figures.index.tolist() == ["uniform", "mine"]
    assert figures.localised_share_20mm.uniform > figures.localised_share_20mm.mine
    with Image.open(tmp_path / "run" / "accuracy.png") as picture:
        assert picture.size[0] == 1100
    logged, artifacts = metrics_of(tmp_path)
    assert {"figures.csv", "accuracy.png"} <= artifacts
    assert logged["localised_share_20mm/mine"] == pytest.approx(figures.localised_share_20mm.mine)
    assert re.search(r"predicted error, median +\d+\.\d mm", done.stdout)
