"""Server of the planner: a planning session in a browser.

Viser's callbacks, a search and the background work each have a thread of their own. These threads only append actions
to one queue. The thread in `Planner.run` runs the actions in order; only this thread uses the session, so no lock is
needed.
"""

import contextlib
import io
import logging
import operator
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from lmd.core.checks import InputError
from lmd.core.optional import optional
from lmd.optimisers.base import Optimiser
from lmd.optimisers.ledger import Budget
from lmd.planner.actions import HOST, Access, ActionQueue, call_in_order
from lmd.planner.background import Background
from lmd.planner.panel import DELETE, UNDO, PlannerPanel
from lmd.planner.picture import MOST_CAPTIONS, RoomPicture
from lmd.planner.plan import Plan
from lmd.planner.session import PlanningSession
from lmd.planner.viewing import pointed_at, span_of
from lmd.space.surface import SurfaceArrays

IDLE_SECONDS = 0.5  # time without an action after which background work begins, seconds


class Planner:
    """Server of a session for browsers on this machine, at a new address at each start (`lmd.planner.actions`).

    Args:
        session: session to serve.
        port: port of the address; 0 for any free port.
        save: function that writes a plan and returns a text about the written files.
        optimiser: function that makes the optimiser of a search.
        budget: initial budget of searches.
        seed: seed of the random poses off the grid; None to compute no metrics off the grid.

    Raises:
        InputError: viser is not installed or its requests cannot be checked, or the port is in use.
    """

    def __init__(
        self,
        session: PlanningSession,
        port: int,
        save: Callable[[Plan], str],
        optimiser: Callable[[], Optimiser],
        budget: Budget,
        seed: int | None,
    ) -> None:
        viser = optional("viser", "view")
        self._session = session
        self._save_files, self._optimiser = save, optimiser
        self._actions = ActionQueue()
        self._surfaces = SurfaceArrays.of(session.problem.scene.footprints.hanging.surfaces())
        self._selected: int | None = None
        self._dragged: int | None = None
        self._span = (0.0, 1.0)  # values of the first and the last colour
        self._pointer: Any = None  # last event of a drag, if the event is not applied yet
        logging.getLogger("websockets.server").setLevel(logging.WARNING)
        self._access = Access()
        with contextlib.redirect_stdout(io.StringIO()), self._access.checking():  # viser prints a banner
            self._server = viser.ViserServer(host=HOST, port=port, verbose=False)
        if port not in (0, self._server.get_port()):
            self._server.stop()
            raise InputError(f"port {port} is in use.", "port")
        self._picture, value = RoomPicture(self._server, session.problem), session.problem.objective.value_label
        few, sizes = len(session.deployment) <= MOST_CAPTIONS, session.problem.scene.tag.sizes
        self._panel = PlannerPanel(self._server.gui, value, budget, ids=few, edges=sizes)
        self._background = Background(session, self._actions, self._panel, self._picture, seed)
        self._listen()
        self._show()

    @property
    def address(self) -> str:
        """Address for browsers; all other addresses are refused."""
        return self._access.address(self._server.get_port())

    def run(self) -> None:
        """Run actions until an exception other than `InputError` is raised, for example by Ctrl-C.

        At this end, the best deployment of a running search is applied to the plan.
        """
        try:
            while True:
                action = self._actions.next(IDLE_SECONDS) or self._idle
                try:
                    action()
                except InputError as error:
                    self._panel.say(str(error), refused=True)
        finally:
            self._session.end_search()

    def close(self) -> None:
        """End the background work and the server; the work may take a while to end."""
        self._background.close()
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()

    def _listen(self) -> None:
        panel = self._panel
        for register, answer in (
            (panel.save.on_click, self._save),
            (panel.tag.on_click, self._change_tag),
            (panel.step.on_click, self._step),
            (panel.optimise.on_click, self._optimise_or_stop),
            (panel.positions.on_update, self._show_or_hide),
            (panel.names.on_update, self._show_or_hide),
            (panel.ids.on_update, self._show_or_hide),
            (panel.additions.on_update, self._background.show_additions),
            (self._picture.cells.on_click, self._click_surface),
        ):
            self._actions.on(register, answer)

    def _idle(self) -> None:
        if self._session.search is not None:
            self._show_search()
        elif self._dragged is None:
            self._background.begin()

    def _point(self, event: Any) -> None:
        """Record the place to which the user has dragged a tag; a later place replaces an earlier one.

        The function runs in viser's thread.
        """
        if event.phase == "start":
            self._actions.put_answer(self._grab, event.instance_index)
        self._pointer = event
        self._actions.put_answer(self._follow)
        if event.phase == "end":
            self._actions.put(self._drop)

    # Actions of users.

    def _grab(self, index: int) -> None:
        self._select(index)
        self._dragged = self._selected

    def _follow(self) -> None:
        event, self._pointer = self._pointer, None
        if event is None or self._dragged is None:
            return
        own = int(self._session.deployment.surfaces[self._session.plan.index_of(self._dragged)])
        eye = np.asarray(event.client.camera.position)
        place = pointed_at(self._surfaces, eye, np.asarray(event.end_position) - eye, own)
        if place is None:
            return
        try:
            self._session.drag(self._dragged, *place)
        except InputError:
            self._dragged = None
            raise
        self._show()

    def _drop(self) -> None:
        self._session.drop()
        self._dragged = None
        self._show()

    def _click_tag(self, event: Any) -> None:
        self._select(event.instance_index)

    def _select(self, index: int) -> None:
        ids = self._session.deployment.ids
        # A browser may still show a tag that was deleted.
        self._selected = int(ids[min(operator.index(index), len(ids) - 1)])
        self._show_tags()

    def _click_surface(self, event: Any) -> None:
        eye, way = np.asarray(event.ray_origin), np.asarray(event.ray_direction)
        place = pointed_at(self._surfaces, eye, way)
        if self._panel.adds.value and place is not None:
            self._selected = self._session.add(*place, self._panel.edge)
            self._panel.say(f"tag {self._selected} was added")
            self._show()
        elif self._background.additions is not None:
            self._panel.say_addition(float(self._background.additions[event.instance_index]))

    @property
    def _chosen(self) -> int:
        """Id of the selected tag.

        Raises:
            InputError: no tag is selected.
        """
        if self._selected is None:
            raise InputError("click a tag first.")
        return self._selected

    def _change_tag(self, event: Any) -> None:
        if event.target.value == DELETE:
            self._session.delete(self._chosen)
        else:
            self._session.pin(self._chosen)
        self._show()

    def _step(self, event: Any) -> None:
        if event.target.value == UNDO:
            self._session.undo()
        else:
            self._session.redo()
        self._show()

    def _optimise_or_stop(self, _: Any) -> None:
        if self._session.search is not None:
            self._session.search.stop()
            return
        self._session.optimise(self._optimiser(), self._panel.budget, done=lambda: self._actions.put(self._take))
        self._background.stop()
        self._panel.say("optimising")
        self._show_search()

    def _take(self) -> None:
        try:
            gained = self._session.take()
        finally:
            self._panel.show_progress(None, running=False)
            self._show()
        self._panel.say(f"the fitness is {gained:.3%} higher" if gained else "nothing better was found")

    def _save(self, _: Any) -> None:
        try:
            self._panel.say(f"saved in {self._save_files(self._session.plan)}")
        except OSError as error:
            raise InputError(f"the plan could not be saved ({error}).") from None
        self._session.note_saved()

    # Display.

    def _show(self) -> None:
        """Show the changed plan, and the metrics that are available immediately."""
        self._background.stop()
        session, problem = self._session, self._session.problem
        with self._server.atomic():
            self._show_tags()
            values = session.values()
            if self._dragged is None:  # during a drag the meaning of colours must not change
                self._span = span_of(values)
            self._picture.show_values(values, self._span)
            self._panel.show_span(self._span)
            rows = problem.describe(session.metrics(), len(session.deployment))
            self._panel.show_figures(rows | session.gains())
            self._background.announce()
        self._server.flush()

    def _show_tags(self) -> None:
        session = self._session
        deployment, plan = session.deployment, session.plan
        if self._selected not in deployment.ids:
            self._selected = None
        number, scene = self._selected, session.problem.scene
        self._panel.show_tag("no tag is selected" if number is None else plan.described(number, scene))
        if self._picture.show_tags(plan, number, self._panel.ids.value):
            self._actions.on(self._picture.tags.on_click, self._click_tag)
            call_in_order(self._picture.tags.on_drag, self._point)

    def _show_or_hide(self, _: Any) -> None:
        self._picture.balls.visible = self._panel.positions.value
        self._picture.captions.show_names(self._panel.names.value)
        self._show_tags()

    def _show_search(self) -> None:
        """Show the progress of a search."""
        search = self._session.search
        assert search is not None, "it is running"
        self._panel.show_progress(search.progress, running=True)
        if search.progress is not None:
            plan = replace(self._session.plan, deployment=search.progress.best)
            self._picture.show_tags(plan, self._selected, self._panel.ids.value)
