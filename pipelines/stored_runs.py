"""Sources of a reproduction report: tables of the paper, and runs that a tracking store holds."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from lmd.core.checks import LARGEST, InputError, printable
from lmd.evaluation.comparison import OptimiserRun
from lmd.plot.common import shrink
from lmd.problem import Problem
from lmd.scene.deployment import Deployment

from .nodes import note
from .operations.tracking import PARENT_TAG, MlflowReader
from .outputs import HISTORY_FILE, read_history

INDICES = {
    "qualified_ratio": "qualified ratio",
    "average_coverage_probability": "average",
    "maximum_coverage_probability": "maximum",
}
RATIO = "metrics.qualified_ratio"
GRID_FREE = "metrics.validation/grid_free_qualified_ratio"
PAIR = ["params.objective.n", "params.objective.thold_p"]
SEED = "params.seed"
PARENT = f"tags.{PARENT_TAG}"
OPTIMISER = "tags.choice.optimiser"
BUDGET = "params.budget.evaluations"
COUNT = "params.deployment.count"

# Tables II (for n = 2 and thold_p = 0.65) and III (for the deployment that EGA found for this pair) of the paper, with
# the names of `Problem.metrics`: Lei et al., "Optimization of Directional Landmark Deployment for Visual Observer on
# SE(3)", Sec. V-A: the room of 7.5 x 5 x 6 m, K = 90 landmarks, 400 iterations with populations of 30.
PRINTED: Any = pd.read_csv(Path(__file__).with_name("paper_tables.csv"))
TABLE_2 = {row.deployment: row for row in PRINTED[PRINTED.table == 2].itertuples()}
TABLE_3 = {(row.n, row.thold_p): row for row in PRINTED[PRINTED.table == 3].itertuples()}

# Columns that a report reads; a store may lack some columns.
COLUMNS = [
    *("status", "started", "tags.sweep", "tags.job", PARENT, OPTIMISER, "tags.choice.deployment"),
    *(SEED, BUDGET, COUNT, *PAIR, *(f"metrics.{index}" for index in INDICES), GRID_FREE),
]

# Parameters that a section reads as numbers, by sweep; a store holds parameters as texts, of any origin.
NUMBERS = {
    **{"table2": [SEED], "landmark_count": [COUNT], "table3": PAIR, "table3_reoptimised": PAIR},
}


@dataclass(frozen=True)
class Source:
    """Runs of a report, and the folder of its pictures."""

    reader: MlflowReader
    """Reader of the tracking store."""
    runs: pd.DataFrame
    """Table of the runs, see `MlflowReader.runs`."""
    load: Callable[[str], tuple[Problem, Deployment]]
    """Function that loads the problem and the deployment of a run, given the id of the run."""
    folder: Path
    """Folder of the pictures."""

    def jobs(self, sweep: str) -> pd.DataFrame:
        """Finished runs of the newest sweep with the name `sweep`: one run for each job, the oldest first.

        A run with a parameter that should be a number but is not is left out, with a note.
        """
        runs = self.runs.reindex(columns=COLUMNS)
        jobs: pd.DataFrame = runs[(runs["tags.sweep"] == sweep) & (runs["status"] == "FINISHED") & runs[PARENT].notna()]
        if jobs.empty:
            return jobs
        jobs = jobs[jobs[PARENT] == jobs[PARENT].iloc[-1]]
        jobs = jobs.drop_duplicates("tags.job", keep="last")
        for key in NUMBERS.get(sweep, ()):
            numbers = pd.to_numeric(jobs[key], errors="coerce")
            is_number = numbers.abs() <= LARGEST
            for run_id, value in jobs[key][~is_number].items():
                note(printable(f"run {run_id} is left out: its {key} is {value!r}, which is not a number"))
            jobs = jobs[is_number]
        return jobs

    def optimiser_runs(self, jobs: pd.DataFrame) -> list[OptimiserRun]:
        """Results and histories of the optimiser runs in `jobs`; a run with a missing file is left out, with a note."""
        found = []
        for run_id, job in jobs.iterrows():
            try:
                history = read_history(self.reader.artifact(str(run_id), HISTORY_FILE))
                deployment = Deployment.from_csv(self.reader.artifact(str(run_id), "landmarks.csv"))
            except InputError as error:
                note(printable(f"run {run_id} is left out: {error}"))
                continue
            metrics = {index: job[f"metrics.{index}"] for index in INDICES}
            found.append(OptimiserRun(str(job[OPTIMISER]), int(float(job[SEED])), metrics, history, deployment))
        return found

    def picture(self, name: str, caption: str, draw: Callable[..., None], *arguments: Any) -> str:
        """Draw a picture by calling `draw` with a path in the report's folder, and return the Markdown that shows it.

        Args:
            name: name of the file without its ending.
            caption: text below the picture.
            draw: function that writes a picture to a path.
            arguments: further arguments of `draw`.
        """
        path = self.folder / f"{name}.png"
        draw(path, *arguments)
        shrink(path)
        return f"![{caption}]({path.name})"
