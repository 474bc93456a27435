"""`suite=NAME`: a frozen problem of the suite in place of the defaults."""

import sys
from collections.abc import Mapping
from typing import Any

from hydra.core.config_store import ConfigStore

from .app import command_of

KEY = "suite="
OPTION = "suite"  # option of the groups below
GROUPS = ("room", "camera", "pdf", "tag", "visibility", "objective")  # groups that a problem decides
PLACES_CAMERAS = "place_cameras"


def read_frozen_problem(pipeline: str) -> None:
    """Make the groups of the problem in `suite=NAME` on the command line options called `suite`, and choose them.

    The number of landmarks of the problem holds for the start of a search, unless the command line gives another
    source of landmarks. Must be called before Hydra reads the command line; ends the process if the problem is unknown
    or for another command. `compare` reads the key by itself.
    """
    given = [argument for argument in sys.argv[1:] if argument.startswith(KEY)]
    if not given or pipeline == "compare" or given[-1] == f"{KEY}null":
        return
    from lmd.core.checks import InputError
    from lmd.suite import document
    from lmd.suite.documents import with_paths

    try:
        frozen = document(given[-1].removeprefix(KEY))
        named = [argument.partition("=")[0].lstrip("+~").partition("@")[0] for argument in sys.argv[1:]]
        for key in named:
            if key.split(".")[0] in ("run", *GROUPS):
                raise InputError(f"suite={frozen.name} has a frozen problem: leave {key} out.")
        _check_command(pipeline, frozen.name, frozen.problem)
    except InputError as error:
        sys.exit(f"error: {error}")
    nodes, store = with_paths(frozen.problem), ConfigStore.instance()
    groups = (*GROUPS, "body") if pipeline == PLACES_CAMERAS else GROUPS
    for group in groups:
        store.store(OPTION, nodes[group], group)
    chosen = [f"{group}={OPTION}" for group in groups]
    if pipeline == PLACES_CAMERAS:
        store.store(OPTION, {"defaults": ["file", "_self_"], **nodes["deployment"]}, "deployment")
        chosen += [f"cameras.{key}={value}" for key, value in nodes["cameras"].items()]
    elif "count" in nodes["deployment"]:
        store.store(OPTION, {"defaults": ["random", "_self_"], **nodes["deployment"]}, "deployment")
    if "deployment" not in named:
        chosen.append(f"deployment={OPTION}")
    place = sys.argv.index(given[-1]) + 1  # after it, as options of Hydra may follow
    sys.argv[place:place] = chosen


def _check_command(pipeline: str, name: str, nodes: Mapping[str, Any]) -> None:
    """Raise `InputError` if a problem is for another command."""
    from lmd.core.checks import InputError

    if "objective" not in nodes or "second" in nodes:
        raise InputError(f"suite={name} has two objectives, which no command takes: use lmd.suite.problem({name!r}).")
    if ("cameras" in nodes) != (pipeline == PLACES_CAMERAS):
        other, what = (PLACES_CAMERAS, "cameras") if "cameras" in nodes else ("optimise", "landmarks")
        raise InputError(f"suite={name} places {what}: {command_of(other)} suite={name} does.")
