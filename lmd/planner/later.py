"""What is worked out of a plan when nobody does anything."""

from functools import partial
from typing import Any

import numpy as np

from lmd.planner.acts import Acts
from lmd.planner.additions import Additions, additions
from lmd.planner.off_grid import off_grid
from lmd.planner.panel import ADDITIONS, Panel
from lmd.planner.picture import Picture
from lmd.planner.session import Posed, Session
from lmd.planner.worker import Wanted, Worker

TO_COME = {"off the grid": "..."}


class Later:
    """Finds figures off the grid, what tags would add, then exacter figures, and shows them; in a thread of its own.

    Args:
        session: whose plan it is.
        acts: where what is to be shown goes.
        panel: shows figures.
        picture: shows what tags would add.
        seed: of the sample off the grid; None to leave that out.
    """

    def __init__(self, session: Session, acts: Acts, panel: Panel, picture: Picture, seed: int | None) -> None:
        self._session, self._acts, self._panel, self._picture, self._seed = session, acts, panel, picture, seed
        self.additions: Additions | None = None
        self._worker = Worker(self._work, lambda *failure: acts.put(partial(self._take_failure, *failure)))

    def announce(self) -> None:
        """Show which figures are to come."""
        if self._seed is not None:
            self._panel.show_off_grid(TO_COME)

    def begin(self) -> None:
        """Work on the plan as it is, unless that is done or being done."""
        self._worker.ask(self._session.posed)

    def stop(self) -> None:
        """Leave it be."""
        self._worker.ask(None)

    def close(self) -> None:
        """End what is at work, which may take a while."""
        self._worker.close()

    def show_additions(self, _: Any = None) -> None:
        """Show what tags would add to what a user has chosen."""
        key = ADDITIONS.get(self._panel.additions.value)
        gains = None if self.additions is None or key is None else getattr(self.additions, key)
        self._picture.show_additions(gains)
        self._panel.show_legend(None if gains is None else float(np.nanmax(gains, initial=0.0)))

    def _work(self, posed: Posed, wanted: Wanted) -> None:
        """In the thread of the worker."""
        figures = iter(()) if self._seed is None else off_grid(*posed, self._seed, wanted)
        self._hand_over(posed, next(figures, None))
        found = additions(*posed, self._picture.candidates.poses, wanted)
        if found is not None:
            self._acts.put(partial(self._take_additions, found))
        self._hand_over(posed, next(figures, None))

    def _hand_over(self, posed: Posed, rows: dict[str, str] | None) -> None:
        if rows is not None:
            self._acts.put(partial(self._take_off_grid, posed, rows))

    def _take_additions(self, found: Additions) -> None:
        self.additions = found
        self.show_additions()

    def _take_off_grid(self, posed: Posed, rows: dict[str, str]) -> None:
        if posed is self._session.posed:
            self._panel.show_off_grid(rows)

    def _take_failure(self, posed: Posed, why: str) -> None:
        if posed is self._session.posed:
            self._panel.show_off_grid({})  # nothing is to come
            self._panel.say(why, refused=True)
