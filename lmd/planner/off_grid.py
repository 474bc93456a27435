"""The figures off the grid of a plan: a first estimate at once, then those that `evaluate` has."""

from collections.abc import Callable, Iterator

from lmd.evaluation.validation import Sample, describe_validation, validation_metrics
from lmd.problem import Problem
from lmd.scene.deployment import Deployment

FIRST_SAMPLE = Sample(groups=8, positions=256, divisions=8)  # takes a fiftieth of the whole sample
ESTIMATE = {"a first estimate": "all digits follow"}


class UnwantedError(Exception):
    """Nobody wants to know any more."""


def off_grid(
    problem: Problem, deployment: Deployment, seed: int, wanted: Callable[[], bool]
) -> Iterator[dict[str, str]]:
    """The figures off the grid as labelled sentences, where poses are sampled first those of a small sample.

    Args:
        problem: what the tags are for.
        deployment: the tags.
        seed: of the samples.
        wanted: asked now and then whether to go on; if not, nothing more comes.
    """

    def check() -> None:
        if not wanted():
            raise UnwantedError

    samples = (FIRST_SAMPLE, Sample()) if problem.scene.recorded is None else (None,)
    try:
        for sample in samples:
            figures = validation_metrics(problem, deployment, seed, sample, check)
            check()
            yield describe_validation(problem, figures) | (ESTIMATE if sample is FIRST_SAMPLE else {})
    except UnwantedError:
        return
