"""Documents of the suite: each file `problems/NAME.yaml` holds a frozen problem with its hash, bound and budgets.

The record of the best known candidate is in `problems/best/NAME.yaml`.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any

from lmd.core.checks import Checked, Count, InputError, choice, real
from lmd.core.files import read_bytes, read_keys
from lmd.suite.families import SEPARATOR, TARGET, drawn, instance_name, instance_of

SETS = ("small", "full")
"""Names of the sets of problems; the full set contains the small set."""
FILE = "path"
"""Key in a document's `problem` whose value is the path of a file, relative to `FOLDER`."""
MOVED = {
    "lmd.formats.deployments.FileDeployment": "lmd.formats.tag_maps.FileDeployment",
    "lmd.space.relevance.Relevance": "lmd.space.space.Relevance",
}
"""Present name of each class that has been renamed or moved, keyed by its old name, which the documents contain.
Digests are computed from the old names.
"""
HASH_DIGITS = 16
KEYS = ("about", "set", "version", "hash", "budgets", "bound", "problem")
FOLDER = Path(__file__).parent / "problems"
"""Folder that holds the documents and the files that they name. The folder is not in `conf`, where Hydra would take it
for a group.
"""
BEST = FOLDER / "best"
"""Folder that holds the best known candidates and their records."""


@dataclass(frozen=True)
class Document(Checked):
    """A frozen problem of the suite.

    Raises:
        InputError: a value is out of range.
    """

    name: str
    """Name of the problem and of its file."""
    about: str
    """Description of the problem in one sentence."""
    set: Annotated[str, partial(choice, options=SETS)]
    """Name of the smallest set that contains the problem, one of `SETS`."""
    version: Count
    """Version of the problem; if the hash changes, the version must change, too."""
    hash: str
    """Digest of everything that determines the fitness, as `digest` computes it."""
    budgets: Sequence[int]
    """Three budgets, as numbers of evaluations, in ascending order."""
    bound: Annotated[float, partial(real, above=0.0, high=1.0)] | None
    """Proven upper bound on the fitness of all candidates; None if no bound below 1 is known."""
    best: Mapping[str, Any] | None
    """Record of the best known candidate, made by `lmd.suite.records.verify`; None if there is no record yet."""
    problem: Mapping[str, Any]
    """Config nodes of the problem, as in a configuration of `pipelines.optimise`."""

    def _validate(self) -> None:
        if not self.budgets or sorted(set(self.budgets)) != list(self.budgets):
            raise InputError(f"{self.name}: budgets must ascend, got {list(self.budgets)}.", "budgets")

    @property
    def digest(self) -> str:
        """Hexadecimal digest of the problem's config nodes and of the contents of all files that they name."""
        text = hashlib.sha256(json.dumps(self.problem, sort_keys=True).encode())
        files = dict[str, str]()
        _changed(self.problem, {FILE: lambda file: files.setdefault(file, file)})
        for file in sorted(files):
            text.update(read_bytes(FOLDER / file, f"{self.name}: {FILE}"))
        return text.hexdigest()[:HASH_DIGITS]


def names(which: str = "full") -> list[str]:
    """Names of the problems in the set `which` (`small` or `full`, which has all problems), sorted.

    Raises:
        InputError: the set is unknown.
    """
    choice("set", which, SETS)
    every = sorted(path.stem for path in FOLDER.glob("*.yaml"))
    return every if which == "full" else [name for name in every if document(name).set == which]


@cache
def document(name: str) -> Document:
    """Document of the problem `name`, or of an instance of a problem, such as `tiny_mean-3`.

    The document of an instance has no upper bound on the fitness, and no best candidate.

    Raises:
        InputError: no problem has that name, or its document is damaged.
    """
    family, instance = name.partition(SEPARATOR)[0], instance_of(name)
    frozen = _frozen(family)
    if instance == 0:
        return frozen
    nodes = drawn(frozen.problem, family, instance)
    made = replace(frozen, name=instance_name(family, instance), bound=None, best=None, problem=nodes)
    return replace(made, hash=made.digest)


def _frozen(name: str) -> Document:
    choice("suite", name, names())
    path = FOLDER / f"{name}.yaml"
    values = read_keys(path, "suite")
    if set(values) != set(KEYS):
        raise InputError(f"suite: {path.name} must have the keys {', '.join(KEYS)}, got {', '.join(values)}.")
    record = BEST / path.name
    return Document(name=name, best=read_keys(record, "suite") if record.exists() else None, **values)


def with_paths(node: Any) -> Any:
    """Copy the config nodes of a problem, with full paths of files, and with new names of renamed classes (`MOVED`)."""
    return _changed(node, {FILE: lambda file: str(FOLDER / file), TARGET: lambda target: MOVED.get(target, target)})


def _changed(node: Any, change: Mapping[str, Callable[[str], str]]) -> Any:
    """Copy nested mappings and lists, and replace the values of certain keys.

    `change` has a function for each of these keys, which returns the new value for the old value.
    """
    if isinstance(node, Mapping):
        return {
            key: change[key](str(value)) if key in change and value is not None else _changed(value, change)
            for key, value in node.items()
        }
    return [_changed(value, change) for value in node] if isinstance(node, list) else node
