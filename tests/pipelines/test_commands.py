"""Every command and study as a user meets it: its exit code, its files, its words and what mlflow has of it."""

import json
import re
import shlex

import pandas as pd
import pytest
from mlflow import MlflowClient
from support.processes import ROOT, inside
from support.recordings import MOVING, simulated

pytestmark = pytest.mark.slow
LANDMARKS = "id,x,y,z,nx,ny,nz,note\n7,0,2,3,1,0,0,by the door\n3,0,3,3,1,0,0,\n9,7.5,2,3,-1,0,0,\n"
COARSE = "room.spacing=3 deployment.count=20 picture=false"
CAMERA = "camera.pixel_width=0.0116 camera.pixel_height=0.0116 camera.principal_point=[400,300] camera.image_width=800"
FRAMES = f"room.spacing=3 {CAMERA} camera.image_height=600 tag.edge=0.3 validate=false"
MINE = "'mine: file deployment.path=mine.csv'"
FIRST = "landmarks.csv metrics.json history.csv"
FLIGHT = "trajectory.duration=2 seeds=2"
SMALL_BODY = '"body.boxes=[{low: [-0.1, -0.1, 0], high: [0.1, 0.1, 0.2]}]"'
SEARCH = "room.spacing=1.5 objective.thold_p=0.3 picture=false validate=false budget.evaluations=30"
# Command, overrides, files that it leaves, and words that it prints.
COMMANDS = {
    "optimise": (
        "room.spacing=1.5 objective.thold_p=0.3 optimiser=ega budget.evaluations=60 deployment.count=40",
        f"{FIRST} checkpoint.npz room.png scene.png convergence.png",
        r"qualified ratio +\d+\.\d\d% of 36 positions see at least 2 of 40 landmarks",
    ),
    "optimise cameras": (
        f"varies=cameras deployment=uniform {COARSE} validate=false budget.evaluations=12 {SMALL_BODY}",
        f"{FIRST} checkpoint.npz rig.yaml",
        r"files +\S+/run: .*rig.yaml",
    ),
    "evaluate": (
        f"{COARSE} sensitivity=true deployment.mounting_error=0.005",
        f"{FIRST} localisation.csv accuracy.csv losses.csv assumptions.csv misses.csv tags.csv lost.csv mounting.csv "
        "mountings.csv mounting_views.csv",
        r"tags off by 5 mm along their surface(.|\n)*off the grid +\d+\.\d\d% \+- \d\.\d\d% of random positions",
    ),
    "evaluate side by side": (
        f'"deployments=[uniform,{MINE}]" room.spacing=3 losses=false localisation=false picture=false validate=false',
        "scores.csv " + " ".join(f"{n}/{f}" for n in ("uniform", "mine") for f in FIRST.split()),
        r"uniform +mine\nfitness",
    ),
    "evaluate two studies": (
        f"studies=[score,accuracy] {COARSE} losses=false localisation=false validate=false",
        f"{FIRST} accuracy/figures.csv accuracy/accuracy.png",
        r"views localised to 20 mm +\d",
    ),
    "evaluate bound": (
        "studies=[bound] room.spacing=2.0 pdf.divisions=6 bound.spacing=1.0 bound.iterations=40 bound.seconds=null "
        "deployment.count=12 bound.target=0.5",
        "bound.json",
        r">= \d+\.\d\d% of the best 12 poses of the grid(.|\n)*>= \d+ for a fitness of 50.00%",
    ),
    "evaluate uncertainty": (
        "studies=[uncertainty] experiment=lab uncertainty.views=3000 uncertainty.frames=40",
        "uncertainty.csv uncertainty_law.csv uncertainty_law.json uncertainty.png VisionUncertainty.java",
        r"corners +errors of aruco in 40 rendered images",
    ),
    "evaluate acceptance": (
        f"studies=[acceptance] {COARSE} tag.edge=0.3 acceptance.headings=4 acceptance.shift=0.1 acceptance.mean=0.1",
        "stations.csv stations_tags.csv stations.pdf",
        r"\d+ stations show a tag that is 0.1 m off",
    ),
    "evaluate detect": (
        f"studies=[detect] {FRAMES} frames=24 pictures=1 detectors=[aruco,apriltag_decimate2] workers=2 "
        f'"deployments=[uniform,{MINE}]"',
        "detect.md figures.csv pitches.csv tags.csv detect.json calibration.png frames/uniform_0.png frames/mine_0.png",
        r"\| mine \| apriltag_decimate2 \|",
    ),
    "evaluate observe": (
        f'studies=[observe] room.spacing=3 {FLIGHT} estimator=[observer,bound] "deployments=[{MINE},uniform,random]"',
        "figures.csv curves.csv paired.csv observe.md observe.json errors.png",
        r"simulated with trajectory=random_motion sensor=noisy",
    ),
    "compare": (
        f"{SEARCH} deployment.count=20 optimisers=[ega,random_search] seeds=2 workers=1",
        "comparison.csv comparison.md comparison.png "
        + " ".join(
            f"runs/{name} seed={seed}/{file}"
            for name in ("ega", "random_search")
            for seed in (0, 1)
            for file in ("landmarks.csv", "history.csv")
        ).replace(" seed", "~seed"),
        r"4/4 \w+ seed=1: fitness",
    ),
    "tradeoff": (
        "room.spacing=3 counts=[10,20] seeds=1 budget.evaluations=10 workers=1 kept=kept",
        "points.csv front.csv tradeoff.json tradeoff.png points/K-10-seed-0/landmarks.csv "
        "points/K-20-seed-0/landmarks.csv",
        r"medians over 1 seeds",
    ),
    "tradeoff size": (
        "size=true camera=lab tag.edge=0.1 visibility=fiducial",
        "size.txt",
        r"0 deg +0\.\d+ m +\d\.\d+ m(.|\n)*largest black square on one sheet: 0\.167 m \(a4\)",
    ),
    "estimate_pdf": ("recording.path=flight.csv", "pdf.csv pdf.png pdf_estimate.json", r"use it with +pdf=samples"),
    "calibrate_detector": (
        f"{FRAMES} views.count=200 frames=10 detectors=[aruco,apriltag_decimate2]",
        "36h11_aruco.yaml 36h11_apriltag_decimate2.yaml calibration.md calibration.json calibration.png",
        r"\| apriltag_decimate2 \|",
    ),
    "export": (
        "deployment.path=mine.csv tag.edge=0.15",
        "tags.wpilib.json tags.apriltag_ros.yaml tags.apriltag_ros2.yaml tags.tagslam.yaml tags.aruco.yaml tags.csv "
        "tags.rtabmap.txt tags.fmap tags.json tags.ros2_tf.launch.py "
        "plan.pdf sheets.pdf",
        r"tags +3 of 36h11, 150 mm \(black square\)",
    ),
}


def files_below(folder):
    below = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return {str(path) for path in below if path.parts[0] != ".hydra"}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_leaves_its_files_its_words_and_its_run(name, tmp_path):
    (tmp_path / "mine.csv").write_text(LANDMARKS)
    simulated(**MOVING).to_csv(tmp_path / "flight.csv")
    overrides, files, words = COMMANDS[name]
    done = inside(name.split()[0], *shlex.split(overrides), "hydra.run.dir=run", cwd=tmp_path, settings=())
    assert done.returncode == 0, done.stderr
    expected = {file.replace("~", " ") for file in files.split()}
    assert files_below(tmp_path / "run") == expected
    assert all((tmp_path / "run" / file).stat().st_size for file in expected)
    assert re.search(words, done.stdout), done.stdout
    client = MlflowClient(tracking_uri=f"sqlite:///{tmp_path}/outputs/mlflow.db")
    own = [e.experiment_id for e in client.search_experiments()]
    runs = [run for run in client.search_runs(own) if "mlflow.parentRunId" not in run.data.tags]
    assert [run.info.status for run in runs] == ["FINISHED"]
    kept = {file.path.split("/")[-1] for file in client.list_artifacts(runs[0].info.run_id)}
    top = {file for file in expected if file.count("/") == 0} - {"checkpoint.npz"}
    assert kept >= {*top, "config.yaml", "packages.txt"}
    if (tmp_path / "run" / "metrics.json").is_file():
        follows_the_contract(tmp_path / "run", runs[0].data.metrics)


def follows_the_contract(run, logged):
    """Landmarks and figures of a run are as scripts may rely on."""
    metrics, landmarks = json.loads((run / "metrics.json").read_text()), (run / "landmarks.csv").read_text()
    assert landmarks.startswith("id,x,y,z,nx,ny,nz")
    assert len(landmarks.splitlines()) == 1 + metrics["settings"]["landmarks"]
    for key in ("qualified_ratio", "average_coverage_probability", "maximum_coverage_probability"):
        assert 0.0 <= metrics[key] <= 1.0
    assert logged["qualified_ratio"] == metrics["qualified_ratio"]
    assert list(pd.read_csv(run / "history.csv")) == ["evaluations", "best_fitness", "wall_time"]
    assert ("validation" in metrics) == ("off_grid" in logged)


def test_the_table_has_every_command():
    names = {path.stem for path in (ROOT / "pipelines").glob("*.py") if "__main__" in path.read_text()}
    elsewhere = {"survey", "localise", "report", "runs", "view"}  # have files of tests of their own
    assert {name.split()[0] for name in COMMANDS} | elsewhere == names
    studies = {path.stem for path in (ROOT / "conf" / "studies").glob("*.yaml")}
    assert studies - {"score"} <= {word for name in COMMANDS for word in name.split()} | {"accuracy"}


def test_a_run_is_scored_exported_flown_and_improved_where_it_was(tmp_path):
    """As in docs/running.md; ids, notes and the fixed tags of a table go through all of it."""
    (tmp_path / "mine.csv").write_text(LANDMARKS)
    given = ["deployment.path=mine.csv", "objective.n=1", "objective.thold_p=0.05", "room.spacing=1.5", "tag.edge=0.15"]
    quiet = ["tracking=none", "picture=false", "validate=false"]
    steps = (
        ("evaluate", [*given, *quiet, "losses=false", "localisation=false", "hydra.run.dir=first"]),
        ("evaluate", ["run=first", *quiet, "hydra.run.dir=again"]),
        ("optimise", ["run=first", *quiet, "budget.evaluations=1e2", "hydra.run.dir=better"]),
        ("export", ["run=better", "tracking=none", "formats=[csv]", "hydra.run.dir=maps"]),
        ("evaluate", ["run=better", "studies=[observe]", "tracking=none", FLIGHT.split()[0], "seeds=1",
                      "deployments=[run,uniform]", "hydra.run.dir=flown"]),
    )  # fmt: skip
    for command, overrides in steps:
        done = inside(command, *overrides, cwd=tmp_path, settings=())
        assert done.returncode == 0, done.stderr
    tables = [pd.read_csv(tmp_path / name / "landmarks.csv", keep_default_na=False) for name in ("first", "better")]
    assert all(table.note.tolist() == ["by the door", "", ""] for table in tables)
    figures = [json.loads((tmp_path / name / "metrics.json").read_text()) for name in ("first", "again", "better")]
    assert figures[0]["fitness"] == figures[1]["fitness"] <= figures[2]["fitness"]
    assert pd.read_csv(tmp_path / "maps" / "tags.csv").id.tolist() == [7, 3, 9]
    flown = pd.read_csv(tmp_path / "flown" / "figures.csv")
    assert set(flown.deployment) == {"run", "uniform"}
    config = (tmp_path / "again" / ".hydra" / "config.yaml").read_text()
    assert "path: first/landmarks.csv" in config  # the options in use, so that the next `run=` reads them


def test_equal_settings_give_equal_results_on_any_number_of_threads(tmp_path):
    for threads in (1, 2):
        words = [*SEARCH.split(), "optimiser=ega", "tracking=none", f"threads={threads}", f"hydra.run.dir={threads}"]
        assert inside("optimise", *words, cwd=tmp_path, settings=()).returncode == 0
    assert (tmp_path / "1" / "landmarks.csv").read_bytes() == (tmp_path / "2" / "landmarks.csv").read_bytes()


def test_places_where_nothing_is_covered_are_explained(tmp_path):
    words = ("visibility.thold=1.2", "localisation=false", "losses=false", "picture=false", "tracking=none")
    done = inside("evaluate", *words, "room.spacing=3", "hydra.run.dir=run", cwd=tmp_path, settings=())
    assert done.returncode == 0, done.stderr
    assert re.search(r"criterion .*\nresolution .* depth up to 0\.72 m \(thold = 1\.2 pixel/mm\)\n", done.stdout)
    criteria = json.loads((tmp_path / "run" / "metrics.json").read_text())["criteria"]
    assert criteria["covered"] == 0.0 < criteria["covered_without_resolution"]
