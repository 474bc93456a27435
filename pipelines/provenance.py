"""Provenance of a run: parameters, command, version of the code, and contents of the files that the run reads.

Results are stored under a digest of the provenance.
"""

import getpass
import hashlib
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from lmd import __version__

from .app import CONF, IN_CHECKOUT, changes_results, command_of, flat_settings
from .operations.sweeps.folder import current_job
from .outputs import Content, read_document, write_document

# Characters around a path in an override, such as `deployments=['mine: file deployment.path=a.csv',uniform]`; the first
# pattern leaves a path with a space whole.
SEPARATORS = (r"[,=\[\]{}'\"]+", r"[\s,=\[\]{}'\"]+")
RECORD = ".hydra/config.yaml"  # file in a folder with the settings of the run whose files are there
PACKAGES_FILE = "packages.txt"
DIRTY = "uncommitted changes"  # tag of a run from a checkout with changes
Computed = Callable[[], dict[str, Any]]
LARGEST_READ = 1 << 32  # files up to this size are read, bytes; for larger files only the size counts


def command_line(pipeline: str, overrides: Sequence[str]) -> str:
    """Command of this project as a line for a shell: the pipeline with its overrides."""
    return " ".join([command_of(pipeline), shlex.join(overrides)]).strip()


def source_tags(pipeline: str) -> dict[str, str]:
    """Labels (tags of mlflow) for the origin of a run: user, command, version and commit.

    Most of the labels have names that mlflow defines.
    """
    tags = {"mlflow.source.name": command_of(pipeline), "mlflow.source.type": "LOCAL", "mlflow.user": _user()}
    given = sys.argv[1:]
    if current_job() is not None:  # when repeated by hand, a command must not write to the folder of the sweep
        given = [word for word in given if not word.startswith(("hydra.run.dir=", "resume="))]
    return tags | {"command": command_line(pipeline, given)} | _version()


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # in a container, the user may have no name
        return "unknown"


@cache
def _version() -> dict[str, str]:
    tags = {"version": __version__}
    if commit := _git("rev-parse", "HEAD").strip() if IN_CHECKOUT else "":
        tags |= {"mlflow.source.git.commit": commit, DIRTY: "yes" if _git("status", "-s") else "no"}
    return tags


def repeating(tags: Mapping[str, str]) -> str:
    """Text in Markdown about how to repeat a run: its command and its commit, both from the run's `source_tags`."""
    from lmd.core.words import as_code

    commit = tags.get("mlflow.source.git.commit", "")[:9]
    changes = f", with {DIRTY}" if tags.get(DIRTY) == "yes" else ""
    return as_code(tags["command"]) + (f"\n\nat commit {commit}{changes}" if commit else "")


def write_sources(directory: Path) -> None:
    """Write the list of installed packages to a directory; if this fails, print a warning and write nothing."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        (directory / PACKAGES_FILE).write_text(_packages())
    except OSError as error:
        print(f"warning: {directory} has no {PACKAGES_FILE} ({error.strerror})", file=sys.stderr)


@cache
def _packages() -> str:
    """List of the installed packages, one line `name==version` for each.

    Names and versions are read from the names of the packages' metadata folders, which takes a few milliseconds.
    """
    found = {name for folder in filter(os.path.isdir, sys.path) for name in os.listdir(folder)}
    names = (name.removesuffix(".dist-info").replace("-", "==", 1) for name in found if name.endswith(".dist-info"))
    return "".join(f"{name}\n" for name in sorted(names, key=str.lower))


def _git(*arguments: str) -> str:
    """Output of git in this checkout; empty without git or a repository."""
    try:
        line = ["git", "--no-optional-locks", *arguments]  # a killed run would leave a lock behind
        done = subprocess.run(line, cwd=Path(CONF).parent, capture_output=True, timeout=5.0, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.decode(errors="replace")


def parameters(cfg: DictConfig, choices: Mapping[str, str]) -> dict[str, Any]:
    """Parameters of a run: the option chosen in each config group, and all settings that have a value.

    Settings that have no effect on results are left out.
    """
    settings = {key: value for key, value in flat_settings(cfg).items() if value not in (None, [])}
    left_out = ("run", "_target_", "_partial_")  # the settings of an earlier run are themselves parameters
    kept = [key for key in {**choices, **settings} if changes_results(key) and key.split(".")[-1] not in left_out]
    return {key: settings.get(key, choices.get(key)) for key in kept}


def digest(*parts: Any) -> str:
    """Digest of any values, including the contents of files that the values name.

    Equal digests mean equal values and equal contents of the files.
    """
    text = json.dumps([*parts, contents_of(parts)], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def contents_of(settings: Any) -> dict[str, str]:
    """Digest of the contents of every file named in `settings`, keyed by file.

    An example is `{"contents of flight.csv": "9f86d081884c7d65"}`. A file is found if a text in the settings, or a word
    in such a text, is its path, or if a text is the path of its folder.

    Args:
        settings: resolved settings, nested in any way, or overrides.
    """
    from lmd.core.checks import printable

    texts = list(texts_in(settings))
    words = set(texts) | {word for text in texts for each in SEPARATORS for word in re.split(each, text)}
    files = {Path(word) for word in words if os.path.isfile(word)}
    folders = [Path(text) for text in texts if os.path.isdir(text) and os.access(text, os.R_OK)]
    files |= {file for folder in folders for file in (*folder.iterdir(), folder / RECORD) if os.path.isfile(file)}
    return {printable(f"contents of {file}"): _digest_of(file) for file in sorted(files) if os.access(file, os.R_OK)}


def texts_in(settings: Any) -> Iterator[str]:
    """Yield all strings in `settings`, which may be nested in any way."""
    if isinstance(settings, str):
        yield settings
    elif isinstance(settings, Mapping | list | tuple):
        for entry in settings.values() if isinstance(settings, Mapping) else settings:
            yield from texts_in(entry)


def _digest_of(file: Path) -> str:
    if (size := file.stat().st_size) > LARGEST_READ:
        return f"{size} bytes"
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()[:16]


def kept(folder: str, parts: tuple[Any, ...], compute: Computed, content_of: Callable[[Any], Content]) -> Content:
    """Read a result from the disk; if it is not stored yet, compute and store it.

    The name on the disk is a digest of everything that determines the result.

    Args:
        folder: folder of the stored results.
        parts: settings and deployments that determine the result, see `digest`; the digest also includes the code of
            `lmd`.
        compute: function that computes the result as a document.
        content_of: function that converts a document to the result, see `read_document`.
    """
    from lmd.core.sources import package_digest

    path = Path(folder) / f"{digest(*parts, package_digest())}.json"
    found = read_document(path, content_of)
    if found is not None:
        return found
    computed = compute()
    path.parent.mkdir(parents=True, exist_ok=True)
    write_document(path, computed)
    return content_of(computed)
