"""Planning by hand: the user drags tags over a room's surfaces in a browser.

The metrics of the plan on the grid are updated immediately.

- `server` serves the planner; `actions` checks requests from browsers, and runs them in order.
- `session` is the state of planning: a `plan` with undo, the plan's metrics (`figures`), and a search by an optimiser.
- `background` computes the metrics that take longer while the user does nothing.
- `panel` and `picture` draw; `viewing` relates the view of a browser to the room.
"""
