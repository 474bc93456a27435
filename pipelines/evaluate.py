"""Evaluate deployments: `python -m pipelines.evaluate deployment=uniform|random|greedy|file [overrides]`.

`studies=[score,bound,...]` chooses the studies, and `deployments=[a,b]` compares several deployments.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from hydra.utils import get_object
from omegaconf import DictConfig

from .command import Command
from .composing import compared
from .study import Report, Study

if TYPE_CHECKING:
    from .operations.tracking import Tracker


def evaluate(cfg: DictConfig) -> Study:
    """Return one study that conducts all studies listed in `studies`, for the configured deployments."""
    from lmd.core.checks import InputError, seed_number

    seed_number(cfg.seed)
    if not cfg.get("studies"):
        raise InputError("studies must name at least one option of conf/studies.")
    own = compared(cfg)
    prepared: dict[str, Study] = {str(name): get_object(study)(cfg, own) for name, study in cfg.studies.items()}
    first = next(iter(prepared.values()))
    if len(prepared) == 1:
        return first

    def run(tracker: "Tracker") -> Iterator[Report]:
        for name, study in prepared.items():
            for report in study.reports(tracker):
                yield report if name == "score" else report.below(name)

    return Study(" ".join(prepared), run, problem=first.problem, returned=first.returned)


main = Command("evaluate", evaluate)

if __name__ == "__main__":
    main()
