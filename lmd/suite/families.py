"""Families of problems: each problem of the suite has random variants, its numbered "instances".

The room, the camera, the number of landmarks, the size of the tags and the parameters of the objective of an instance
are drawn from the distributions in `draws.yaml`. The name of the problem and the number of the instance are the seed.
Instance 0 is the problem itself, without changes.
"""

import copy
import zlib
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import InputError
from lmd.core.files import read_keys

TARGET = "_target_"

HELD_OUT = 1000
"""Number of the first held-out instance: no optimiser and no default is tuned on instances from this number on."""
SEPARATOR = "-"
"""Character between the family and the number of the instance in the name of a problem."""
DIGITS = 4  # significant digits of a drawn number


def instance_name(family: str, instance: int) -> str:
    """Name of an instance of a family, such as `tiny_mean-3`; instance 0 has the name of the family."""
    return f"{family}{SEPARATOR}{instance}" if instance else family


def instance_of(name: str) -> int:
    """Number of the instance in the name of a problem.

    Raises:
        InputError: the name does not end in a number.
    """
    number = name.partition(SEPARATOR)[2] or "0"
    if not number.isdecimal():
        raise InputError(f"suite: an instance must be a number, as in tiny_mean{SEPARATOR}3, got {name!r}.", "suite")
    return int(number)


def drawn(nodes: Mapping[str, Any], family: str, instance: int) -> dict[str, Any]:
    """Draw an instance, that is, a random variant of a problem of the suite.

    A problem is described by nested mappings, as in a configuration file.

    Args:
        nodes: mappings of the problem, which are not changed.
        family: name of the problem; the name and `instance` are the seed of the random draws.
        instance: number of the instance, from 1 on.

    Returns:
        copy of `nodes` in which some numbers are randomly changed.
    """
    rng = np.random.default_rng([zlib.crc32(family.encode()), instance])
    made = copy.deepcopy(dict(nodes))
    is_counted = "counts" in made["tag"]  # numbers of tags of each size, so that their sum is the number of landmarks
    done = list[int]()
    for part in _parts(made):
        if id(part) in done:  # a tag shared by the scene and its visibility model
            continue
        done.append(id(part))
        for paths, draw in _draws().get(part[TARGET], {}).items():
            if not (is_counted and paths == "count"):
                ((operation, bounds),) = draw.items()
                by = rng.uniform(*np.array(bounds).T)
                for path in paths.split():
                    _change(part, path.split("."), operation, by)
    return made


@cache
def _draws() -> Mapping[str, Any]:
    return read_keys(Path(__file__).with_name("draws.yaml"), "suite")


def _parts(node: Any) -> Iterator[dict[str, Any]]:
    """Yield all mappings within `node` that name a class (`_target_`); a nested mapping precedes the outer one."""
    for value in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
        yield from _parts(value)
    if isinstance(node, dict) and TARGET in node:
        yield node


def _change(node: Any, path: Sequence[str], operation: str, by: Any) -> None:
    """Change the values at `path` in a config node, in place.

    The operation `times` multiplies a value by `by`; any other operation adds `by`. Nothing is changed if the node
    lacks the path. `*` in the path stands for all items of a list.
    """
    first, *rest = path
    for key in range(len(node)) if first == "*" else [first] if first in node else []:
        if rest:
            _change(node[key], rest, operation, by)
        else:
            node[key] = _changed(node[key], operation, by)


def _changed(value: Any, operation: str, by: Any) -> Any:
    """Return a number, a vector or a list of vectors, multiplied by `by` (operation `times`) or increased by `by`.

    `by` is one number, or one number for each coordinate of a vector. An integer stays an integer; other numbers are
    rounded to `DIGITS` significant digits.
    """
    numbers = np.array(value)
    each = by[: numbers.shape[-1]] if np.ndim(by) else by
    found = numbers * each if operation == "times" else numbers + each
    shorter = np.vectorize(lambda number: float(f"{number:.{DIGITS}g}"))
    return round(float(found)) if isinstance(value, int) else shorter(found).tolist()
