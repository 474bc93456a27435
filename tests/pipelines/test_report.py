"""The report: tables beside the printed ones, pictures, and what it says where runs are missing."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from markdown import markdown as markdown_to_html
from matplotlib.image import imread
from mlflow import MlflowClient
from omegaconf import OmegaConf
from support import stores  # noqa: F401 - new ones get their tables from it
from support.composing import composed

import pipelines.report
from lmd.core.checks import InputError
from lmd.core.tables import write_table
from lmd.optimisers.ledger import Record, columns_of
from pipelines.app import CONF
from pipelines.building import build_problem
from pipelines.operations.tracking import PARENT_TAG, MlflowTracker, RunStart
from pipelines.outputs import HISTORY_FILE
from pipelines.sections import COMMANDS
from pipelines.stored_runs import TABLE_2, TABLE_3

SMALL = ("room.spacing=1.5", "deployment.count=6", "objective.thold_p=0.5", "threads=1")
AVERAGE, MAXIMUM = 0.6, 0.9  # of every run


def small_config():
    """A problem of 36 positions and six landmarks."""
    return composed("optimise", *SMALL, "deployment=uniform")


def record_sweep(uri, folder, name, jobs, pipeline="optimise"):
    """Record a sweep and its jobs; returns the id of the parent run.

    Args:
        uri: the store.
        folder: for the files that jobs keep.
        name: of the sweep.
        jobs: for each job the overrides that tell it from the others, its qualified ratio and its status.
        pipeline: what ran.
    """
    cfg = small_config()
    problem = build_problem(cfg)
    problem.start.draw(problem.scene.room, np.random.default_rng(0)).to_csv(folder / "landmarks.csv")
    OmegaConf.save(cfg, folder / "config.yaml")
    sweep = {"sweep": name, "pipeline": pipeline}
    parent = MlflowTracker(uri, "lmd")
    tags = sweep | {"command": f"python -m pipelines.{pipeline} experiment={name} seed=0,1"}
    parent.start(RunStart(f"sweep {name}", folder / name, tags=tags))
    for number, (overrides, ratio, status) in enumerate(jobs):
        tracker = MlflowTracker(uri, "lmd")
        tags = sweep | {"job": f"job-{number}", PARENT_TAG: parent.run_id}
        tags |= {f"choice.{key}": value for key, value in overrides.items() if "." not in key}
        settings = {"seed": number, "budget.evaluations": 60, "objective.n": 2, "objective.thold_p": 0.65}
        params = settings | {"deployment.count": 90} | overrides
        tracker.start(RunStart(f"{name} {number}", folder / name / str(number), params, tags))
        if status == "FINISHED":
            tracker.log_metrics(
                {
                    "qualified_ratio": ratio,
                    "average_coverage_probability": AVERAGE,
                    "maximum_coverage_probability": MAXIMUM,
                }
            )
            write_table(folder / HISTORY_FILE, columns_of([Record(30, ratio / 2.0, 0.1), Record(60, ratio, 0.2)]))
            tracker.log_artifacts([folder / name for name in ("landmarks.csv", "history.csv", "config.yaml")])
        tracker.finish(status)
    parent.log_metrics({"jobs": len(jobs)})
    parent.finish("FINISHED")
    return parent.run_id


def record_all(uri, folder):
    """Every sweep that a report is made of; returns the parents' ids by name."""

    def done(*jobs):
        return [(overrides, ratio, "FINISHED") for overrides, ratio in jobs]

    seeds = [({"optimiser": "ega"}, 0.4), ({"optimiser": "ega"}, 0.6), ({"optimiser": "ega"}, 0.5)]
    pairs = [({"objective.n": n, "objective.thold_p": p}, 0.9 - 0.2 * n + p / 10) for n in (2, 3) for p in (0.5, 0.65)]
    sweeps = {
        "table2": (done(*seeds, ({"optimiser": "sga"}, 0.3)), "optimise"),
        "table2_baselines": (done(({"deployment": "random"}, 0.1), ({"deployment": "uniform"}, 0.2)), "evaluate"),
        "table3": (done(*pairs), "evaluate"),
        "table3_reoptimised": (done(*((pair, ratio + 0.1) for pair, ratio in pairs)), "optimise"),
        "landmark_count": (done(*(({"deployment.count": k}, k / 100) for k in (30, 60, 90))), "optimise"),
    }
    return {name: record_sweep(uri, folder, name, jobs, pipeline) for name, (jobs, pipeline) in sweeps.items()}


def write_report(folder, *overrides):
    """Report into `folder`, which must not exist, in this process; returns the Markdown."""
    folder.mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pipelines.report, "run_directory", lambda: folder)
        place = SimpleNamespace(provider="main", schema="file", path=CONF)
        runtime = SimpleNamespace(config_sources=[place])
        patch.setattr(pipelines.report.HydraConfig, "get", lambda: SimpleNamespace(runtime=runtime))
        pipelines.report.report(composed("report", *overrides))
    return (folder / "report.md").read_text()


pytestmark = pytest.mark.slow  # mlflow makes its tables anew for each store

ROOT = Path(__file__).parents[2]
PICTURES = {"convergence.png", "deployments.png", "landmark_count.png", "pairs.png"}


def rows(markdown, first):
    """Rows of a table that begin with the cells `first`."""
    lines = [line.strip("| ").split(" | ") for line in markdown.splitlines() if line.startswith("| ")]
    return [cells[len(first) :] for cells in lines if cells[: len(first)] == list(first)]


@pytest.fixture(scope="module")
def reported(tmp_path_factory):
    """A store with every sweep, two of `table2`, and the report on it: its folder, the store, the ids of the sweeps."""
    cwd = tmp_path_factory.mktemp("work")
    uri = f"sqlite:///{cwd}/mlflow.db"
    older = [({"optimiser": "ega"}, 0.75, "FINISHED"), ({"optimiser": "ega"}, 0.0, "FAILED")]
    old = record_sweep(uri, cwd, "table2", older)
    ids = record_all(uri, cwd) | {"old": old}
    write_report(cwd / "report", f"tracking.uri={uri}")
    return cwd / "report", f"tracking.uri={uri}", ids


@pytest.fixture(scope="module")
def markdown(reported):
    return (reported[0] / "report.md").read_text()


def test_the_printed_ratios_count_756_positions_and_the_maxima_325_orientations():
    for printed in (*TABLE_2.values(), *TABLE_3.values()):
        for value, parts in ((printed.qualified_ratio, 756), (printed.maximum_coverage_probability, 325)):
            assert round(np.rint(value * parts) / parts, 4) == value
    assert TABLE_3[2, 0.65][2:] == TABLE_2["EGA"][2:]


def test_a_report_is_markdown_and_pictures(reported):
    left = {path.name for path in reported[0].iterdir()}
    assert left == {"report.md", *PICTURES}
    assert all((reported[0] / name).stat().st_size < 150_000 for name in PICTURES)
    assert all(imread(reported[0] / name).ndim == 3 for name in PICTURES)


def test_table_2_has_the_median_and_the_range_of_the_newest_sweep_beside_what_was_printed(markdown):
    (row,) = rows(markdown, ["EGA"])
    assert row[:3] == ["3", "81.88%", "50.00% (40.00% to 60.00%)"]
    assert row[3:] == ["75.00%", "60.00%", "91.69%", "90.00%", "–"]
    assert rows(markdown, ["SGA"])[0][:3] == ["1", "53.44%", "30.00%"]
    assert rows(markdown, ["uniform"])[0][:3] == ["1", "43.92%", "20.00%"]
    assert rows(markdown, ["initial"])[0][:3] == ["1", "11.11%", "10.00%"]


def test_table_3_sets_each_pair_beside_its_own(markdown):
    table, own = rows(markdown, ["3", "0.65"])
    assert table[:3] == ["1", "37.04%", "36.50%"]
    assert own == ["37.04%", "36.50%", "46.50%"]
    without, own = rows(markdown, ["4", "0.80"])
    assert without[:3] == ["0", "0.00%", "–"]
    assert own == ["0.00%", "–", "–"]


def test_the_fewest_landmarks_that_reach_the_papers_ratio_are_named(markdown):
    assert rows(markdown, ["60"]) == [["1", "60.00%"]]
    assert "With 90 landmarks, the fewest here, the median of the runs reaches 81.88%" in markdown


def test_every_section_says_which_command_made_its_runs(markdown):
    said = "4 runs of `python -m pipelines.optimise experiment=table2 seed=0,1` with a budget of 60 evaluations; the"
    assert said in markdown
    assert "2 runs of `python -m pipelines.evaluate experiment=table2_baselines seed=0,1`" in markdown
    assert "There are no finished runs" not in markdown


HOSTILE = "</code>`<script>alert(1)</script>` | [x](javascript:alert(1))\n\n<script>alert(2)</script>"


def test_a_strangers_store_puts_no_markup_into_a_page(tmp_path):
    """Tags and parameters are what anybody has written; the site makes HTML of the Markdown."""
    uri = f"sqlite:///{tmp_path}/mlflow.db"
    jobs = [({"optimiser": "ega", "budget.evaluations": HOSTILE}, 0.5, "FINISHED")]
    sweep = record_sweep(uri, tmp_path, "table2", jobs, pipeline=HOSTILE)
    MlflowClient(tracking_uri=uri).set_tag(sweep, "command", HOSTILE)
    text = write_report(tmp_path / "report", f"tracking.uri={uri}")
    made = markdown_to_html(text, extensions=["tables", "attr_list"])
    assert "<script" not in made
    assert "href" not in made
    assert "alert(2)" in made


def test_a_run_with_a_value_that_is_no_number_is_left_out_and_named(tmp_path, capsys):
    uri = f"sqlite:///{tmp_path}/mlflow.db"
    counts = [({"deployment.count": count}, 0.6, "FINISHED") for count in ("many", "1e999", 60)]
    record_sweep(uri, tmp_path, "landmark_count", counts)
    record_sweep(uri, tmp_path, "table2", [({"optimiser": "ega", "seed": "first"}, 0.5, "FINISHED")])
    pairs = [({"objective.n": n, "objective.thold_p": 0.5}, 0.5, "FINISHED") for n in ("two", 2)]
    record_sweep(uri, tmp_path, "table3", pairs)
    text = write_report(tmp_path / "report", f"tracking.uri={uri}")
    told = capsys.readouterr().err
    values = {"deployment.count": "many", "seed": "first", "objective.n": "two"}
    for what in (*(f"{key} is {value!r}" for key, value in values.items()), "deployment.count is '1e999'"):
        assert f"is left out: its params.{what}, which is not a number" in told
    assert rows(text, ["60"]) == [["1", "60.00%"]]
    assert rows(text, ["2", "0.50"])[0][0] == "1"
    for sweep, (command, more) in COMMANDS.items():
        assert (ROOT / "conf" / "experiment" / f"{sweep}.yaml").is_file()
        line = f"python -m pipelines.{command} experiment={sweep}{more}"
        sentence = f"There are no finished runs of the sweep `{sweep}`; `{line}` makes them."
        assert (sentence in text) == (sweep not in ("landmark_count", "table3"))


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["tracking=none"], r"The report reads runs from mlflow: set tracking=mlflow\."),
        (["tracking.uri=sqlite:///none.db"], r"tracking\.uri = 'sqlite:///none\.db': there is no file 'none\.db'\."),
        (["tracking.experiment_name=x"], r"has no experiment called 'x' \(tracking\.experiment_name\)\."),
    ],
)
def test_bad_input_gets_one_sentence_and_leaves_nothing(reported, tmp_path, monkeypatch, overrides, message):
    monkeypatch.chdir(tmp_path)
    store = [] if overrides[0].startswith(("tracking=", "tracking.uri")) else [reported[1]]
    with pytest.raises(InputError, match=message):
        write_report(tmp_path / "bad", *store, *overrides)
    assert not list((tmp_path / "bad").iterdir())
