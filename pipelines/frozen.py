"""`suite=NAME`: a frozen problem of the suite in place of the defaults; `-m suite=A,B` sweeps over several."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.config_store import ConfigStore

from .app import CONF, command_of

if TYPE_CHECKING:
    from lmd.suite import Document

GROUP = "suite"
GROUPS = ("room", "camera", "pdf", "tag", "visibility", "objective")  # groups that a problem decides
PLACES_CAMERAS = "place_cameras"
COMPARE = "compare"  # reads the key by itself


def offer_frozen_problems(pipeline: str, arguments: Sequence[str]) -> None:
    """Make the problems that `suite=...` names among the arguments of a command options of the group `suite`.

    Such an option chooses an option of each group that the problem decides, and of `deployment`, which the arguments
    may replace. Must be called before Hydra reads the arguments.

    Raises:
        InputError: a problem is unknown or for another command, or the arguments choose a part of it.
    """
    given = [argument.partition("=")[2] for argument in arguments if argument.startswith(f"{GROUP}=")]
    names = re.findall(r"\w+", given[-1]) if given and pipeline != COMPARE else []
    if not names or names == ["null"]:
        return
    from lmd.core.checks import InputError
    from lmd.suite import document

    if f"- {GROUP}: null" not in Path(CONF, f"{pipeline}.yaml").read_text(encoding="utf-8"):
        raise InputError(f"{GROUP} is no key of {pipeline}: it takes no frozen problem.")
    for name in names:
        frozen = document(name)
        _check_command(pipeline, frozen)
        _offer(frozen, pipeline == PLACES_CAMERAS)
    for argument in arguments:
        key = argument.partition("=")[0].lstrip("+~").partition("@")[0]
        if key.split(".")[0] in ("run", *GROUPS):
            raise InputError(f"suite={given[-1]} has a frozen problem: leave {key} out.")


def _offer(frozen: "Document", places_cameras: bool) -> None:
    """Store the options of a problem; their names begin with `suite_`, as `conf` may have others of its name."""
    from lmd.suite.documents import with_paths

    nodes, store, option = with_paths(frozen.problem), ConfigStore.instance(), f"{GROUP}_{frozen.name}"
    groups = (*GROUPS, "body") if places_cameras else GROUPS
    for group in groups:
        store.store(option, nodes[group], group)
    source = "file" if places_cameras else "random"
    store.store(option, {"defaults": [source, "_self_"], **nodes["deployment"]}, "deployment")
    chosen = [{f"override /{group}": option} for group in (*groups, "deployment")]
    cameras: Mapping[str, Any] = {"cameras": nodes["cameras"]} if places_cameras else {}
    store.store(frozen.name, {"defaults": [*chosen, "_self_"], GROUP: frozen.name, **cameras}, GROUP, "_global_")


def _check_command(pipeline: str, frozen: "Document") -> None:
    """Raise `InputError` if a problem is for another command."""
    from lmd.core.checks import InputError

    name, nodes = frozen.name, frozen.problem
    if "objective" not in nodes or "second" in nodes:
        raise InputError(f"suite={name} has two objectives, which no command takes: use lmd.suite.problem({name!r}).")
    if ("cameras" in nodes) != (pipeline == PLACES_CAMERAS):
        other, placed = (PLACES_CAMERAS, "cameras") if "cameras" in nodes else ("optimise", "landmarks")
        raise InputError(f"suite={name} places {placed}: {command_of(other)} suite={name} does.")
