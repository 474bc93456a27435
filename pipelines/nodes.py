"""Construction of objects from nodes of the configuration, with error messages that name the keys."""

import difflib
import inspect
import re
import sys
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hydra
from omegaconf import DictConfig, OmegaConf

if TYPE_CHECKING:
    from lmd.detection.detectors import Detector

LIKENESS = 0.8  # minimum similarity, by `difflib`, of a suggested key; a missing letter in a word is similar enough


@cache
def note(text: str) -> None:
    """Print a note on stderr unless it is empty; each process prints a note only once."""
    from lmd.core.checks import printable

    if text:
        print(f"note: {printable(text)}", file=sys.stderr)


@contextmanager
def keyed(group: str = "", /, **keys: str) -> Iterator[None]:
    """Context in which the message of an `InputError` names the config key of an argument instead of the argument.

    Args:
        group: key of the node whose keys are the arguments; empty for top-level keys.
        keys: config keys of arguments that do not come from this node, by the name of the argument.
    """
    from lmd.core.checks import InputError

    try:
        yield
    except InputError as error:
        if error.argument is None or not str(error).startswith(error.argument):
            raise
        argument = re.split(r"[^\w]", error.argument)[0]
        named = argument == group.split(".")[0]  # the message already names the key
        key = keys.get(argument, argument if named or not group else f"{group}.{argument}")
        raise InputError(key + str(error).removeprefix(argument)) from None


def instantiate(node: Any, **extra: Any) -> Any:
    """Build the object that a config node describes; no other function calls Hydra's `instantiate`.

    Args:
        node: config node with the key `_target_`.
        extra: further arguments of the object.

    Raises:
        InputError: the object refuses its arguments.
    """
    from hydra.errors import InstantiationException

    from lmd.core.checks import InputError
    from lmd.core.optional import missing_of

    try:
        return hydra.utils.instantiate(node, **extra, _convert_="all")
    except InstantiationException as error:
        cause: BaseException | None = error.__cause__
        while cause is not None and not isinstance(cause, InputError):
            cause = cause.__cause__
        if (lacking := missing_of(error)) is not None:
            raise lacking from None
        with keyed(str(error).partition("full_key: ")[2].strip(), **{name: name for name in extra}):
            raise cause or InputError(_refusal(error, extra)) from (None if cause else error)


def _refusal(error: Exception, extra: Mapping[str, Any]) -> str:
    """Message that replaces Hydra's error about a config node.

    The message states the fault. After an unknown argument, it also names a similar argument or all allowed ones.

    Args:
        error: Hydra's error.
        extra: arguments that were passed in addition to the keys of the node.
    """
    from lmd.core.checks import failure
    from lmd.core.optional import lack_of

    text, _, key = " ".join(str(error).split()).partition(" full_key: ")
    target, cause = re.search(r"target '([^']+)'", text), error.__cause__
    if target is None or cause is None:
        return f"{key}: {text}"
    if text.startswith("Error locating"):
        return f"{key}._target_ = {target[1]!r}: {lack_of(target[1])}"
    unknown = re.search(r"unexpected keyword argument '(\w+)'", str(cause))
    takes = [name for name in inspect.signature(hydra.utils.get_object(target[1])).parameters if name not in extra]
    if unknown is None or unknown[1] in takes:
        raised = Path(traceback.extract_tb(cause.__traceback__)[-1].filename)
        at_the_call = "hydra" in raised.parts or raised.name == "typing.py"
        return f"{key}: {cause if at_the_call else f'{target[1]} failed: {failure(cause)}'}"
    if unknown[1] in extra:
        return f"{key}: {target[1]} must accept the argument {unknown[1]}."
    close = difflib.get_close_matches(unknown[1], takes, 1, LIKENESS)
    likely = f"did you mean {key}.{close[0]}?" if close else f"{target[1]} takes {', '.join(takes) or 'no argument'}"
    return f"{key}.{unknown[1]} is not a known setting; {likely}"


def plain(node: Any) -> Any:
    """Convert a config node to plain Python values, with interpolations resolved; return other values unchanged."""
    return OmegaConf.to_container(node, resolve=True) if OmegaConf.is_config(node) else node


def settings_of(cfg: DictConfig, key: str) -> DictConfig:
    """Return the config node at a key.

    Raises:
        InputError: the value at the key is not a node; a user may have given the name of an option instead.
    """
    from lmd.core.checks import InputError

    found = OmegaConf.select(cfg, key)
    if not isinstance(found, DictConfig):
        raise InputError(f"{key} must be a mapping of settings or the name of an option, got {found!r}.")
    return found


def detectors_of(cfg: DictConfig) -> "dict[str, Detector]":
    """Build the detectors of a configuration; return them by name.

    Raises:
        InputError: a detector refuses its arguments, or does not read the family of the tags.
    """
    return {name: instantiate(settings_of(cfg, f"detectors.{name}")) for name in cfg.get("detectors") or {}}
