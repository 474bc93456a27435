"""What every run leaves in its directory."""

import json
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lmd.deployment import Deployment
    from lmd.optimisers.base import Record
    from lmd.problem import Problem


def write_outputs(
    directory: Path,
    problem: "Problem",
    deployment: "Deployment",
    history: "Sequence[Record]",
    *,
    title: str,
    page: bool,
    summary: Mapping[str, Any],
) -> tuple[dict[str, float], list[Path]]:
    """Write landmarks.csv, metrics.json, history.csv and the pictures, all of them or none.

    Args:
        directory: the run's directory.
        problem: what it is scored for.
        deployment: what is written and shown.
        history: best fitness over the run.
        title: heads the pictures.
        page: whether to write the interactive page.
        summary: further entries of metrics.json.

    Returns:
        the metrics of `deployment`, and the files.
    """
    import pandas as pd

    from lmd.plot.convergence import save_convergence_figure
    from lmd.plot.page import save_scene_page
    from lmd.plot.scene import save_scene_figure

    metrics = problem.metrics(deployment)
    table = pd.DataFrame(history)

    def write(partial: Path) -> None:
        deployment.to_csv(partial / "landmarks.csv", ups=not problem.scene.tag.is_point)
        document = {**metrics, **summary, "settings": problem.settings()}
        (partial / "metrics.json").write_text(json.dumps(document, indent=2) + "\n")
        table.to_csv(partial / "history.csv", index=False)
        save_scene_figure(partial / "scene.png", problem, deployment, title)
        save_convergence_figure(partial / "convergence.png", table, problem.objective.headline, title)
        if page:
            save_scene_page(partial / "scene.html", problem, deployment, title)

    return metrics, all_or_none(directory, write)


def all_or_none(directory: Path, write: Callable[[Path], None]) -> list[Path]:
    """Let `write` fill a folder, then move its files to `directory`; where it fails nothing is left.

    Returns:
        the files in `directory`, sorted.
    """
    with tempfile.TemporaryDirectory(dir=directory, prefix=".partial_") as name:
        write(Path(name))
        return [Path(shutil.move(path, directory / path.name)) for path in sorted(Path(name).iterdir())]
