"""Background work: metrics that take long are computed in a separate thread while the user does nothing."""

import threading
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Generic, TypeVar

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.evaluation.validation import Sample, describe_validation, validation_metrics
from lmd.planner.actions import ActionQueue
from lmd.planner.figures import additions
from lmd.planner.panel import PlannerPanel
from lmd.planner.picture import RoomPicture
from lmd.planner.session import PlanningSession, Posed
from lmd.problem import Problem
from lmd.scene.deployment import Deployment

PATIENCE_SECONDS = 0.5  # maximum time to wait for the end of unwanted work, seconds
TO_COME = {"off the grid": "..."}
FIRST_SAMPLE = Sample(groups=8, positions=256, divisions=8)  # takes a fiftieth of the whole sample's time
ESTIMATE = {"a first estimate": "all digits follow"}

Question = TypeVar("Question")
Wanted = Callable[[], bool]


class Worker(Generic[Question]):
    """Daemon thread that works on one question (a task) at a time; a new question replaces the previous one.

    Args:
        work: function that works on a question. `work` takes the question, and a function that returns True while the
            result is still wanted.
        failed: function that is called in this thread if `work` fails. `failed` takes the question and the reason, as a
            sentence.
    """

    def __init__(self, work: Callable[[Question, Wanted], None], failed: Callable[[Question, str], None]) -> None:
        self._work, self._failed = work, failed
        self._question: tuple[Question] | None = None  # a new tuple for each question
        self._closing = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="worker", daemon=True)
        self._thread.start()

    def ask(self, question: Question | None) -> None:
        """Replace the present question by `question`; None only ends the work on the present question.

        The thread works once on each question that is not replaced first. Asking the present question again has no
        effect.
        """
        with self._changed:
            if question is None:
                self._question = None
            elif self._question is None or self._question[0] is not question:
                self._question = (question,)
                self._changed.notify()

    def close(self) -> None:
        """Ask the thread to end, and wait for at most `PATIENCE_SECONDS`.

        While the thread works, it asks from time to time if the result is still wanted, and ends if not. During the
        compilation of functions it does not ask, so the thread may outlive this call.
        """
        with self._changed:
            self._question, self._closing = None, True
            self._changed.notify()
        self._thread.join(PATIENCE_SECONDS)

    def _run(self) -> None:
        done: tuple[Question] | None = None
        while True:
            with self._changed:
                while not self._closing and (self._question is None or self._question is done):
                    self._changed.wait()
                if self._question is None:
                    return
                done = self._question
            try:
                self._work(done[0], partial(self._is_asked, done))
            except (InputError, MemoryError) as error:
                self._failed(done[0], str(error) or "there is too little memory.")

    def _is_asked(self, question: tuple[Question]) -> bool:
        return self._question is question


class UnwantedError(Exception):
    """Raised to end the computation of a result that is no longer wanted."""


def off_grid(problem: Problem, deployment: Deployment, seed: int, wanted: Wanted) -> Iterator[dict[str, str]]:
    """Yield the metrics of a deployment at random poses off the grid, as sentences keyed by label.

    First come estimates from a small sample of poses, then the metrics that the command `evaluate` gives. If the scene
    has recorded poses, only one set of metrics is yielded, that at the recorded poses.

    Args:
        problem: scene and objective.
        deployment: the tags.
        seed: seed of the samples.
        wanted: function that is called repeatedly, and returns False to end the iteration.
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


class Background:
    """Background work for the present plan: metrics that take longer are computed and shown one after the other.

    First the metrics at random poses off the grid are estimated from a small sample. Then the gain by one more tag is
    computed for each candidate place. Finally the metrics are computed from the full sample.

    Args:
        session: session with the plan.
        actions: queue to which the display of results is appended.
        panel: panel that shows metrics.
        picture: picture that shows gains on surfaces.
        seed: seed of the random poses off the grid; None to compute no metrics off the grid.
    """

    def __init__(
        self,
        session: PlanningSession,
        actions: ActionQueue,
        panel: PlannerPanel,
        picture: RoomPicture,
        seed: int | None,
    ) -> None:
        self._session, self._actions, self._panel, self._picture, self._seed = session, actions, panel, picture, seed
        self.additions: FloatArray | None = None
        self._worker = Worker(self._work, lambda *failure: actions.put(partial(self._take_failure, *failure)))

    def announce(self) -> None:
        """Show a note in the panel that the metrics off the grid will follow."""
        if self._seed is not None:
            self._panel.show_off_grid(TO_COME)

    def begin(self) -> None:
        """Start the background work on the present plan, unless this work is finished or under way."""
        self._worker.ask(self._session.posed)

    def stop(self) -> None:
        """Stop the work on the present plan."""
        self._worker.ask(None)

    def close(self) -> None:
        """End the thread, see `Worker.close`."""
        self._worker.close()

    def show_additions(self, _: Any = None) -> None:
        """Colour the surfaces by the gain by one more tag at each place.

        Surfaces are grey before gains are known, and if the user has switched these colours off.
        """
        gains = self.additions if self._panel.additions.value else None
        self._picture.show_additions(gains)
        self._panel.show_legend(None if gains is None else float(np.nanmax(gains, initial=0.0)))

    def _work(self, posed: Posed, wanted: Wanted) -> None:
        """Compute and report all results for one plan; runs in the worker's thread."""
        figures = iter(()) if self._seed is None else off_grid(*posed, self._seed, wanted)
        self._hand_over(posed, next(figures, None))
        found = additions(*posed, self._picture.candidates.poses, wanted)
        if found is not None:
            self._actions.put(partial(self._take_additions, found))
        self._hand_over(posed, next(figures, None))

    def _hand_over(self, posed: Posed, rows: dict[str, str] | None) -> None:
        if rows is not None:
            self._actions.put(partial(self._take_off_grid, posed, rows))

    def _take_additions(self, found: FloatArray) -> None:
        self.additions = found
        self.show_additions()

    def _take_off_grid(self, posed: Posed, rows: dict[str, str]) -> None:
        if posed is self._session.posed:
            self._panel.show_off_grid(rows)

    def _take_failure(self, posed: Posed, why: str) -> None:
        if posed is self._session.posed:
            self._panel.show_off_grid({})  # no figures will follow
            self._panel.say(why, refused=True)
