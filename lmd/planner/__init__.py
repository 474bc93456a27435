"""Planning by hand: the user drags tags over a room's surfaces in a browser, and all figures are updated immediately.

- `server` serves the planner; `access` refuses other pages; `actions` is the queue of requests from browsers.
- `session` is the state of planning: a `plan` with undo, its `figures`, and a `tag_search` by an optimiser.
- `background` computes slower figures while the user does nothing.
- `panel`, `picture` and `robot` draw; `viewing` relates the view of a browser to the room.
"""
