"""Planning by hand: a browser in which tags are dragged over the surfaces of a room, with all figures updated at once.

- `app` serves the planner; `access` guards it; `actions` queues what browsers ask for.
- `session` is the state behind it: a `plan` with undo, its `figures`, and a `tag_search` by an optimiser.
- `background` computes slower figures while the user rests.
- `panel`, `picture` and `robot` draw; `viewing` relates the view of a browser to the room; `survey_map` reads a survey.
"""
