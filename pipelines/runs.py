"""List the newest runs, and resume one: `python -m pipelines.runs [last=20] [resume=last]`.

Runs whose process has ended are marked first. The command that resumes a run is built from Hydra's files in the run's
folder. Store and folder are not trusted: no command from the store is run, and of the folder's overrides only those are
used that cannot run code or write to other places, each as one argument of a pipeline of this project.
"""

import os
import re
import shlex
import socket
import sys
from collections.abc import Container, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig

from .app import CONF, PACKAGE, command_of
from .command import Command, alone
from .composing import at, config_dir, search_path, task_overrides
from .nodes import instantiate
from .trust import PAGE, SHOWN, TARGET, Trust, listed, read_yaml

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = {
    "name": "run",
    "tags.pipeline": "pipeline",
    "status": "status",
    "started": "started (UTC)",
    "metrics.fitness": "fitness",
    "metrics.off_grid": "off the grid",
    "metrics.evaluations": "evaluations",
}
SHARES = ("metrics.fitness", "metrics.off_grid")  # columns in per cent
OWN_KEYS = ("tracking", "trust")  # keys whose values on this command line replace the values of the run
# Keys of `tracking` that go on with the run, as an experiment may choose none; this command line says where it is
# recorded.
RECORDED = re.compile(r"tracking(\.tags\b.*)?")
PLACE_KEYS = ("hydra", "save_as", "kept")  # keys with a path to which files are written
LIST_KEYS = ("optimisers", "deployments")  # lists of options, each of which may have overrides of its own
# Names of options. With dots and slashes a name could be any file, and with = or ~ an override.
NAMES = re.compile(r"[\w\[\],'\" -]*")
GIVEN = "command-line"  # suffix of Hydra's providers of places on the search path of a command line
# Harmless settings of Hydra.
HARMLESS = re.compile(
    r"hydra\.mode=\w+|hydra/launcher=\w+|hydra/sweeper=basic|hydra/(job|hydra)_logging=\w+|"
    r"hydra\.verbose=[\w.,\[\]]+|hydra\.sweeper\.max_batch_size=[\w.-]+|"
    r"hydra\.launcher\.(n_jobs|partition|timeout_min|cpus_per_task|mem_gb|array_parallelism)=[\w.-]+"
)
PICKLES = ".submitit"  # folder of pickles, which submitit reads, in the folder of a sweep
REPLACED = ("hydra.run.dir", "hydra.sweep.dir", "hydra.searchpath")  # settings that this command replaces


@dataclass(frozen=True)
class ResumeCommand:
    """Command that resumes a run."""

    command: str
    """Text of the command for a shell."""
    process: tuple[str, ...] = ()
    """Program and arguments; empty if the command is only shown."""
    why_not: str = ""
    """Reason for which the command is only shown."""


def resume_command(run: "pd.Series", trust: Trust) -> ResumeCommand | None:
    """Command that resumes a run; None if the run has finished or has left no checkpoint.

    A sweep, with its jobs, is resumed by its own command.

    Args:
        run: row of `MlflowReader.runs`.
        trust: trust of the command line.
    """
    from lmd.core.checks import InputError, printable
    from lmd.optimisers.checkpoint import CHECKPOINT_FILE

    from .operations.tracking import PARENT_TAG

    command, folder = run.get("tags.command"), Path(str(run.get("tags.folder")))
    is_sweep, is_job = (isinstance(run.get(f"tags.{tag}"), str) for tag in ("sweep", PARENT_TAG))
    if run["status"] not in ("KILLED", "FAILED") or not isinstance(command, str) or (is_sweep and is_job):
        return None
    if not folder.is_dir():
        if run.get("tags.host") == socket.gethostname():
            return None
        return ResumeCommand(printable(command), why_not=f"its folder {printable(str(folder))} is not on this host")
    if not is_sweep and not (folder / CHECKPOINT_FILE).is_file():
        return None
    try:
        pipeline, arguments = _command(folder, is_sweep, trust)
    except InputError as error:
        shown = command if is_sweep else f"{command} {at('resume', folder)}"
        return ResumeCommand(printable(shown), why_not=str(error).rstrip("."))
    process = (sys.executable, "-m", f"{PACKAGE}.{pipeline}", *arguments)
    return ResumeCommand(printable(f"{command_of(pipeline)} {shlex.join(arguments)}"), process)


def _command(folder: Path, is_sweep: bool, trust: Trust) -> tuple[str, list[str]]:
    """Pipeline and arguments that resume the run in a folder.

    Raises:
        InputError: the folder is not as written by Hydra, or an override is not accepted from a file.
    """
    from lmd.core.checks import InputError

    file = folder / ("multirun.yaml" if is_sweep else ".hydra/hydra.yaml")
    written: Any = read_yaml(file, "its folder").get("hydra")
    try:
        pipeline, own, task = (str(written["job"]["name"]), *(written["overrides"][key] for key in ("hydra", "task")))
        sources = [source for source in written["runtime"]["config_sources"] if str(source["provider"]).endswith(GIVEN)]
        places = [f"{source['schema']}://{source['path']}" for source in sources]
        keys = [override.partition("=")[0] for override in own]
        given = {key: override for key, override in task_overrides() if key.split(".")[0] in OWN_KEYS}
        kept = [override for override in task if _is_kept(override, str(file), is_sweep, given, trust)]
    except (KeyError, TypeError, AttributeError):
        raise InputError(f"{file} is not written as Hydra writes it") from None
    if not _is_pipeline(pipeline):
        raise InputError(f"{file} names {pipeline[:SHOWN]!r}, which is no pipeline")
    for path in folder.rglob("*"):
        if path.is_symlink():  # the run would write to another place
            raise InputError(f"{path} is a link ({PAGE})")
        if path.name == PICKLES:
            raise InputError(f"{path} holds what jobs and the sweep hand to each other, which may run code ({PAGE})")
    for place in places:
        if not trust.has(place):
            source = f"it read configuration in {place}"
            raise InputError(f"{source}; if that is yours, add {shlex.quote(f'hydra.searchpath=[{place}]')} ({PAGE})")
    for key, override in zip(keys, own, strict=True):
        if HARMLESS.fullmatch(override):
            kept.append(override)
        elif key not in REPLACED:
            raise InputError(f"it was given {override[:SHOWN]!r}, which is not taken from a file ({PAGE})")
    kept += given.values()
    if is_sweep:
        kept.append(at("hydra.sweep.dir", folder))
    else:
        kept += [at("hydra.run.dir", folder)] if "hydra.run.dir" in keys else []
        kept.append(at("resume", folder))
    return pipeline, [*config_dir(), *search_path(), *kept]


def _is_pipeline(name: str) -> bool:
    """True if a name is the name of a pipeline with tracked runs."""
    file = Path(CONF, f"{name}.yaml")
    return (
        name.isidentifier() and file.is_file() and bool(re.search(r"^  - (base|job)$", file.read_text(), re.MULTILINE))
    )


def _is_kept(override: str, source: str, is_sweep: bool, given: Container[str], trust: Trust) -> bool:
    """True if the command keeps an override of the run; other overrides are replaced.

    Args:
        override: the override.
        source: file that holds it.
        is_sweep: True for a sweep, whose jobs may resume the run that they were given.
        given: keys that this command line replaces.
        trust: trust of the command line.

    Raises:
        InputError: the override is not accepted from a file, or names code that is not trusted.
    """
    from lmd.core.checks import InputError

    try:
        parsed = OverridesParser.create().parse_override(override)
    except HydraException:
        raise InputError(f"{source} holds {override[:SHOWN]!r}, which is no override") from None
    key, varies = str(parsed.key_or_group), parsed.is_sweep_override()
    first = re.split("[./]", key)[0]
    is_replaced = first == "tracking" and (key in given or not RECORDED.fullmatch(key))
    if is_replaced or (first == "resume" and not is_sweep):
        return False
    if first == "trust":
        if lacking := [name for name in listed(override) if name not in trust.names]:
            raise InputError(f"it was told trust={lacking}; if you trust that too, add it ({PAGE})")
        return False
    if first in PLACE_KEYS or parsed.package is not None or (varies and TARGET in override.replace("\\", "")):
        raise InputError(f"it was given {override[:SHOWN]!r}, which is not taken from a file ({PAGE})")
    value = override.partition("=")[2]
    trust.check(source, key, value if varies else parsed.value())
    is_group = first in LIST_KEYS or "/" in key or any((folder / key).is_dir() for folder in trust.folders)
    if is_group and not NAMES.fullmatch(value):
        raise InputError(f"it was given {override[:SHOWN]!r}, which is not taken from a file ({PAGE})")
    return True


def runs(cfg: DictConfig) -> None:
    """List the newest runs of the configured store."""
    from lmd.core.checks import InputError, integer, printable

    from .operations.tracking import MlflowReader, MlflowTracker
    from .operations.tracking.journal import end_those_gone
    from .operations.tracking.views import link

    tracker, last = instantiate(cfg.tracking), integer("last", cfg.last, low=1)
    if not isinstance(tracker, MlflowTracker):
        raise InputError("runs are read where they were tracked: it needs tracking=mlflow.")
    reader = MlflowReader(cfg.tracking.uri, cfg.tracking.experiment_name)
    with tracker.store.errors_reported():
        end_those_gone(tracker.store)
    table = reader.runs().iloc[-last:]
    print(_listed(table))
    trust = Trust.given()
    unfinished = {str(run_id): again for run_id, run in table.iterrows() if (again := resume_command(run, trust))}
    for run_id, again in unfinished.items():
        name = printable(f"{table['name'][run_id]} ({run_id})")
        if again.process:
            print(f"\n{name} goes on with:\n{again.command}")
        else:
            print(f"\n{name} does not go on from here: {again.why_not}. Read before you run it:\n{again.command}")
    if cfg.resume is not None:
        _resume(unfinished, str(cfg.resume))
    print(f"\nin the browser, while `make ui` runs: {link(cfg.address, tracker.store.experiment_id)}")


def _listed(table: "pd.DataFrame") -> str:
    from lmd.core.checks import printable

    shown = table.reindex(columns=list(COLUMNS)).rename(columns=COLUMNS)
    for column in ("run", "pipeline"):
        shown[column] = shown[column].fillna("").astype(str).map(printable)
    shown["started (UTC)"] = shown["started (UTC)"].dt.strftime("%Y-%m-%d %H:%M:%S")
    percent = {COLUMNS[key]: "{:.2%}".format for key in SHARES}
    return str(shown.to_string(index=False, na_rep="", float_format="{:g}".format, formatters=percent))


def _resume(unfinished: Mapping[str, ResumeCommand], wanted: str) -> None:
    """Replace this process by the command that resumes the run `wanted`, or the last run."""
    from lmd.core.checks import InputError

    found = list(unfinished) if wanted == "last" else [run_id for run_id in unfinished if run_id.startswith(wanted)]
    if not found:
        raise InputError(f"resume = {wanted!r} is no run among these that can go on.")
    again = unfinished[found[-1]]
    if not again.process:
        raise InputError(f"resume = {wanted!r}: {found[-1]} does not go on from here: {again.why_not}.")
    print(f"\n{again.command}", flush=True)
    os.execv(again.process[0], again.process)


main = Command("runs", runs, runner=alone)

if __name__ == "__main__":
    main()
