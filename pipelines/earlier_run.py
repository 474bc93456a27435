"""`run=DIR`: problem and landmarks of an earlier run instead of the defaults."""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig

from .app import CONF, choices
from .overrides import PATH, quoted, search_path
from .trust import Trust, read_yaml

KEY = "run="
GROUPS = ("room", "camera", "pdf", "poses", "tag", "visibility", "objective")  # groups of the problem of a run
OPTION = "run"  # option of `GROUPS` and of deployment
COUNTED = {"random", "uniform", "greedy"}  # options of deployment that need a number of landmarks
RIG = "rig.yaml"  # file of a run that placed cameras
FILES = (".hydra/config.yaml", "landmarks.csv")  # files that an earlier run must have


def read_earlier_run(deployment: str = f"deployment={OPTION}", further: Sequence[str] = ()) -> None:
    """Turn the groups of the run named by `run=DIR` on the command line into options called `run`, and choose these.

    The fixed landmarks and the number of landmarks of that run are defaults for other sources of landmarks, too.
    Options and keys on the command line have precedence. The function must be called before Hydra reads the command
    line. It ends the process if the run names code that the user does not trust.

    Args:
        deployment: override that chooses the landmarks.
        further: groups of the pipeline in addition to `GROUPS`.
    """
    given = [argument for argument in sys.argv[1:] if argument.startswith(KEY)]
    directory = _directory(given[-1]) if given else None
    if directory is None:
        return
    before, parts = parts_of(directory, "run", (*GROUPS, *further), FILES)
    if "camera" in parts and (rig := directory / RIG).is_file():
        parts["camera"] = {**parts["camera"], "rig": str(rig)}
    store = ConfigStore.instance()
    for group, part in parts.items():
        store.store(OPTION, part, group)
    named = {argument.partition("=")[0].lstrip("+~").partition("@")[0] for argument in sys.argv[1:]}
    hung = before.get("deployment")
    hung = hung if isinstance(hung, dict) else {}
    free, measured, fixed = (hung.get(key) for key in ("free", "measured", "fixed"))  # not all commands have these keys
    path = directory / FILES[1]
    free = bool(free) or measured is not None  # measured places are not checked
    store.store(OPTION, {"defaults": ["file", "_self_"], "path": str(path), "free": free}, "deployment")
    chosen = [f"{group}={OPTION}" for group in parts] + [deployment, *_detector_of(before)]
    options = [argument for argument in (deployment, *sys.argv[1:]) if argument.startswith("deployment=")]
    if options and COUNTED.issuperset(options[-1].partition("=")[2].split(",")):
        chosen.append(f"deployment.count={count_of(directory)}")
    if fixed is not None and "deployment.fixed" not in named:  # the file of fixed landmarks may have changed
        chosen += [f"++deployment.fixed={quoted(path)}", "++deployment.marked=true"]
    if "poses" in named:
        named.add("pdf")  # an option of the group poses sets its own pdf
    place = sys.argv.index(given[-1]) + 1  # directly after `run=`, as options of Hydra may follow
    sys.argv[place:place] = [override for override in chosen if override.partition("=")[0] not in named]


def parts_of(
    directory: Path, argument: str, groups: Sequence[str], files: Sequence[str] = FILES[:1]
) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Configuration of an earlier run, and its nodes of `groups`. It ends the process if they name code that the user
    does not trust, or a file is missing.

    Args:
        directory: folder of the run.
        argument: key that names the run, for messages.
        files: files that the folder must have.
    """
    from lmd.core.checks import InputError

    if missing := [name for name in files if not (directory / name).is_file()]:
        _refuse(f"{argument} = '{directory}' is no {argument} to go on from: it holds no {missing[0]}.")
    try:
        before = read_yaml(directory / FILES[0], argument)
        return before, Trust.given().parts(before, f"{argument}: '{directory / FILES[0]}'", groups)
    except InputError as error:
        _refuse(str(error))


def _detector_of(before: Mapping[str, Any]) -> list[str]:
    """Override that chooses the detector of an earlier run: the one that read its images, or that it was planned for.

    Empty for a command that reads no images, and for a run with several detectors or one that `conf/detectors` lacks.
    """
    command = Path(CONF, Path(sys.argv[0]).stem.removeprefix("lmd-").replace("-", "_")).with_suffix(".yaml")
    if not command.is_file() or "- detectors:" not in command.read_text(encoding="utf-8"):
        return []
    visibility = before.get("visibility")
    planned = visibility.get("detector") if isinstance(visibility, dict) else None
    named = list(before.get("detectors") or [Path(str(planned)).stem])  # limits have the file <family>_<detector>.yaml
    options = [path.stem for path in Path(CONF, "detectors").glob("*.yaml")]
    found = [name for name in options if len(named) == 1 and f"_{named[0]}".endswith(f"_{name}")]
    return [f"detectors=[{name}]" for name in found]


def read_room_of_map() -> None:
    """Take the room of the run whose folder is `map=DIR`, unless the command line names a room or a run."""
    given = [argument for argument in sys.argv[1:] if argument.startswith("map=")]
    others = any(argument.partition("=")[0] in ("run", "room") for argument in sys.argv[1:])
    directory = None if others or not given else _directory(given[-1])
    if directory is None or not (directory / FILES[0]).is_file():
        return
    _, parts = parts_of(directory, "map", ("room",))
    for group, part in parts.items():
        ConfigStore.instance().store(OPTION, part, group)
        sys.argv.insert(1, f"{group}={OPTION}")


def read_earlier_robot() -> None:
    """Read an earlier run with the body that carried its cameras, if there was one; see `read_earlier_run`."""
    read_earlier_run(further=("body",))


def read_earlier_problem() -> None:
    """Read an earlier run with random landmarks of equal number, or with the landmarks of `deployment.path`.

    See `read_earlier_run`.
    """
    from_file = any(argument.startswith(f"{PATH}=") for argument in sys.argv[1:])
    read_earlier_run(f"deployment={'file' if from_file else 'random'}")


def count_of(run: str | Path) -> int:
    """Number of landmarks of the run in a directory."""
    from lmd.core.checks import InputError
    from lmd.core.tables import read_table

    try:
        return len(read_table(Path(run) / FILES[1], name="run").lines)
    except InputError as error:
        _refuse(str(error))


def check_experiment(cfg: DictConfig) -> None:
    """Raise `InputError` if an earlier run and an experiment both choose a group of the problem.

    In Hydra the command line has precedence over an experiment, so only a part of the experiment would be used.
    """
    from hydra.core.global_hydra import GlobalHydra

    from lmd.core.checks import InputError

    name = choices().get("experiment")
    if name is None or cfg.get("run") is None:
        return
    loader = GlobalHydra.instance().config_loader()
    alone = [*search_path(), f"experiment={name}"]
    theirs = loader.compute_defaults_list(HydraConfig.get().job.config_name, alone, RunMode.RUN).overrides
    if twice := [group for group in (*GROUPS, "deployment") if group in theirs.override_choices]:
        raise InputError(
            f"run = {str(cfg.run)!r} and experiment={name} both choose {', '.join(twice)}: leave one of the two out; "
            "what shall differ from the run can be named by itself."
        )


def _refuse(message: str) -> NoReturn:
    """End the process with one sentence, before Hydra begins."""
    print(f"error: {message}", file=sys.stderr)
    sys.exit(1)


def _directory(argument: str) -> Path | None:
    """Value of `run=...` or `map=...`; None for null."""
    try:
        value = OverridesParser.create().parse_override(argument).value()
    except HydraException:  # no override; the message on the directory shows the text
        value = argument.partition("=")[2]
    return None if value is None else Path(str(value))
