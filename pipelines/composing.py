"""Configuration of a command, which is composed in two passes.

1. Hydra composes a first configuration from the files and the command line. In this pass the following keys have no
   effect: `run`, `suite`, `survey`, `map`, `varies`, and `deployment.path` if no option of `deployment` is chosen.
2. Within the job, `settled` reads the values of these keys. If the values choose options, `settled` puts these options
   into Hydra's config store and composes again; the command line still overrides the options.

Some config groups describe an object. Such a group accepts keys that no configuration file has, and passes them on to
the class of the object, which refuses unknown keys.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf, open_dict, read_write

from .app import CONF, COUNT, choices, keyed_overrides, quoted, search_path, spelled, task_overrides
from .trust import Trust, read_yaml

if TYPE_CHECKING:
    from lmd.suite import Document

GROUPS = ("room", "camera", "pdf", "poses", "tag", "visibility", "objective")  # groups of the problem of a run
FROZEN = ("room", "camera", "pdf", "tag", "visibility", "objective")  # groups of a problem of the suite
NODES = ("body", "tag")  # nodes of these commands that are not groups of options
OPTION = "run"  # name of the option of `GROUPS` and of `deployment`
COUNTED = ("random", "uniform", "greedy")  # options of deployment that need a number of landmarks
RIG = "rig.yaml"  # file of a run that placed cameras
FILES = (".hydra/config.yaml", "landmarks.csv")  # files that an earlier run must have
PATH = "deployment.path"
CAMERA_EVALUATIONS = "2000"  # budget of `optimise` with varies=cameras
OPEN = {
    "problem": (*GROUPS, "deployment"),
    "flight": ("trajectory", "sensor", "estimator", "odometry", "start"),
    "images": ("imaging", "detectors"),
    "views": ("views", "board"),
    **{name: (name,) for name in ("acceptance", "optimiser", "recording", "uncertainty")},
}
NAME = re.compile(r"[\w.-]+")  # characters that mlflow accepts in the name of a metric

for _name, _groups in OPEN.items():
    _node = OmegaConf.create({group: {} for group in _groups})
    for _group in _groups:
        OmegaConf.set_struct(_node[_group], False)
    ConfigStore.instance().store(f"open_{_name}", _node)


def compose(command: str, *overrides: str) -> DictConfig:
    """Compose the configuration of a command as the command line would, without running the command.

    `building.build_problem` and `building.build_optimiser` make objects from the configuration.

    Args:
        command: name of the command, such as `optimise`.
        overrides: overrides of the command, such as `experiment=lab` or `suite=tiny_mean`.

    Raises:
        InputError: a frozen problem or an earlier run is refused.
        hydra.errors.HydraException: Hydra refuses the overrides, or another configuration is being composed.
    """
    from hydra import compose as by_hydra
    from hydra import initialize_config_dir

    with initialize_config_dir(CONF, version_base="1.3"):
        composed = by_hydra(command, list(map(spelled, overrides)), return_hydra_config=True)
        again = _overrides(composed, command, overrides, composed.hydra.runtime)
        return _final(_without_hydra(composed) if again is None else by_hydra(command, again))


def settled(cfg: DictConfig) -> DictConfig:
    """Final configuration of this job, read-only; it includes the options that keys such as `run` and `suite` choose.

    These options are also added to Hydra's record of the job, in memory and in the folder of the job.

    Raises:
        InputError: the run, frozen problem, survey or map that a key names cannot be used.
    """
    job: Any = HydraConfig.get()
    if (again := _overrides(cfg, job.job.config_name, job.overrides.task, job.runtime)) is not None:
        composed = _load(job.job.config_name, [*search_path(), *again], "the command line", " ".join(again))
        with read_write(job), open_dict(job):
            job.runtime.choices, job.overrides.task = composed.hydra.runtime.choices, again
        cfg = _without_hydra(composed)
        if (record := Path(job.runtime.output_dir, FILES[0])).is_file():
            OmegaConf.save(cfg, record)
    return _final(cfg)


def editable(node: DictConfig) -> DictConfig:
    """Copy of a config node; in the copy, keys may be changed and added."""
    copied = deepcopy(node)
    for part in (copied, *(inner for inner in copied.values() if OmegaConf.is_config(inner))):
        part._set_flag(["readonly", "struct"], [False, False])
    return copied


def recompose(config_name: str, overrides: Sequence[str], setting: str, entry: str) -> DictConfig:
    """Compose another configuration within this job.

    Args:
        config_name: name of the configuration.
        overrides: overrides of that configuration.
        setting: key that asks for this configuration by its value, for error messages.
        entry: value of the key `setting`.

    Raises:
        InputError: Hydra refuses the overrides.
    """
    return _without_hydra(_load(config_name, [*search_path(), *overrides], setting, entry))


def _load(config_name: str, overrides: Sequence[str], setting: str, entry: str) -> DictConfig:
    from hydra.errors import HydraException

    from lmd.core.checks import InputError

    loader = GlobalHydra.instance().config_loader()
    try:
        every = list(map(spelled, overrides))
        return loader.load_configuration(config_name, every, RunMode.RUN, validate_sweep_overrides=False)
    except (HydraException, ValueError) as error:  # Hydra raises ValueError for an option that is a number
        raise InputError(f"{setting}: {entry!r} is refused: {str(error).splitlines()[0]}") from error


def _without_hydra(composed: DictConfig) -> DictConfig:
    return OmegaConf.masked_copy(composed, [str(key) for key in composed if key != "hydra"])


def _final(cfg: DictConfig) -> DictConfig:
    """Read-only copy of the configuration, without keys that have no effect because of the values of other keys."""
    left_out = ("cameras", "body") if cfg.get("varies") == "tags" else ()
    final = OmegaConf.masked_copy(cfg, [str(key) for key in cfg if key not in left_out])
    OmegaConf.set_readonly(final, True)
    return final


def _overrides(cfg: DictConfig, command: str, given: Sequence[str], runtime: Any) -> list[str] | None:
    """All overrides of the command, or None if none is added to those of the command line.

    Overrides that follow from keys such as `run` and `suite` come first, then the overrides of the command line.

    Args:
        cfg: configuration.
        command: name of the command.
        given: overrides on the command line.
        runtime: Hydra's record of the run.
    """
    from lmd.core.checks import InputError

    named = dict.fromkeys(key for key, _ in keyed_overrides(given))  # keyed in the order of the overrides
    options, trust, run = choices(runtime.choices), Trust.of(cfg, runtime), cfg.get("run")
    found = _of_suite(cfg, named) if isinstance(cfg.get("suite"), str) and command != "compare" else {}
    if "views" in cfg and cfg.survey is not None:
        found |= _of_survey(Path(str(cfg.survey)), trust)
        run = run or found.get("run", "").strip("'") or None
    elif run is not None and options.get("experiment") is not None:
        both = f"run = {str(run)!r} and experiment={options['experiment']}"
        raise InputError(f"{both} both choose the problem: leave one of the two out.")
    if run is not None:
        found |= _of_run(cfg, Path(str(run)), named, command, options, trust)
    elif cfg.get("map") is not None and Path(str(cfg.map), FILES[0]).is_file() and "room" not in named:
        found |= _stored(_parts_of(Path(str(cfg.map)), "map", trust, ("room",))[1], OPTION)
    elif PATH in named and "suite" not in named and options.get("deployment") in COUNTED:
        found |= {"deployment": "file"}
    if cfg.get("varies") == "cameras" or "varies" in found:
        ours = {"optimiser": ("annealing", "camera_annealing"), "deployment": ("random", "file")}
        chosen_anew = {group: option for group, (usual, option) in ours.items() if options[group] == usual}
        found = chosen_anew | {"budget.evaluations": CAMERA_EVALUATIONS} | found
    if "poses" in named:
        named["pdf"] = None  # an option of the group `poses` sets its own pdf
    front = [f"{key}={value}" for key, value in found.items() if key not in named]
    every = [*front, *map(spelled, given)]
    return None if every == list(given) else every


def _stored(parts: Mapping[str, Any], option: str) -> dict[str, str]:
    """Store config nodes in Hydra's config store, and return the overrides that choose these nodes, by group.

    Args:
        parts: the nodes, by group.
        option: name of the option under which each node is stored in its group.
    """
    for group, part in parts.items():
        ConfigStore.instance().store(option, part, group)
    return {f"+{group}" if group in NODES else group: option for group in parts}


def _of_suite(cfg: DictConfig, named: Iterable[str]) -> dict[str, str]:
    """Store the config nodes of the suite's problem `cfg.suite`, and return the overrides that choose these nodes.

    Args:
        cfg: configuration.
        named: keys of the overrides on the command line.

    Raises:
        InputError: the problem is unknown or belongs to another command, or the command line chooses a part of the
            problem.
    """
    from lmd.core.checks import InputError
    from lmd.suite import document
    from lmd.suite.documents import with_paths

    frozen: Document = document(cfg.suite)
    nodes, option = with_paths(frozen.problem), f"suite_{frozen.name}"
    if "objective" not in nodes or "second" in nodes:
        told = f"suite={cfg.suite} has two objectives, which no command optimises"
        raise InputError(f"{told}: use lmd.suite.problem({cfg.suite!r}).")
    cameras = ("body", "cameras") if "cameras" in nodes else ()
    if cameras and "varies" not in cfg:
        raise InputError(f"suite={cfg.suite} places cameras: use the command optimise.")
    for key in named:
        if key.split(".")[0] in ("run", *FROZEN):
            raise InputError(f"suite={cfg.suite} sets {key} itself: leave {key} out.")
    started = {"defaults": ["file" if cameras else "random", "_self_"], **nodes["deployment"]}
    found = _stored({**{group: nodes[group] for group in FROZEN}, "deployment": started}, option)
    for key in cameras:
        ConfigStore.instance().store(option, {k: v for k, v in nodes[key].items() if k != "_target_"}, key)
        found |= {f"+{key}": option, "varies": "cameras"}
    return found


def _of_survey(directory: Path, trust: Trust) -> dict[str, str]:
    """Store the camera and the tag of a survey as config nodes, and return the overrides that choose these nodes.

    Further overrides choose the run and the detectors that the survey used, and set `frames` and `margin` to 0.

    Args:
        directory: folder of the survey.
        trust: code that the user trusts in the survey's configuration.
    """
    before, parts = _parts_of(directory, "survey", trust, ("camera", "tag"))
    found = {"frames": "0", "margin": "0", "detectors": f"[{','.join(before.get('detectors') or {})}]"}
    return {**_stored(parts, "survey"), **found, **({"run": quoted(before["run"])} if before.get("run") else {})}


def _of_run(
    cfg: DictConfig, directory: Path, named: Iterable[str], command: str, options: Mapping[str, str], trust: Trust
) -> dict[str, str]:
    """Store the problem and the landmarks of an earlier run as config nodes; return overrides that choose these nodes.

    If the command line chooses another source of landmarks, the fixed landmarks and the number of landmarks of the
    earlier run remain the defaults.

    Args:
        cfg: configuration.
        directory: folder of the earlier run.
        named: keys of the overrides on the command line.
        command: name of the present command.
        options: option chosen in each config group.
        trust: code that the user trusts in the earlier run's configuration.

    Raises:
        InputError: the run names code that the user does not trust, or lacks a file.
    """
    before, parts = _parts_of(directory, "run", trust, (*GROUPS, *(("body",) if "body" in cfg else ())), FILES)
    if "camera" in parts and (rig := directory / RIG).is_file():
        parts["camera"] = {**parts["camera"], "rig": str(rig)}
    given = before.get("deployment")
    hung = given if isinstance(given, dict) else {}
    path, free = directory / FILES[1], bool(hung.get("free")) or hung.get("measured") is not None
    _stored({"deployment": {"defaults": ["file", "_self_"], "path": str(path), "free": free}}, OPTION)
    found = _stored(parts, OPTION)
    is_search = command in ("compare", "tradeoff")  # these take no landmarks from an earlier run
    start = OPTION if not is_search else "file" if PATH in named else "random"
    found["deployment"] = start
    if (options.get("deployment") if "deployment" in named else start) in COUNTED:
        found["deployment.count"] = str(count_of(directory))
    if hung.get("fixed") is not None and "deployment.fixed" not in named:  # the fixed file may have changed
        found |= {"deployment.fixed": quoted(path), "deployment.marked": "true"}
    if "detectors" in cfg and len(own := list(before.get("detectors") or [])) == 1:  # that read the run's images
        found["detectors"] = f"[{own[0]}]"
    return found


def _parts_of(
    directory: Path, argument: str, trust: Trust, groups: Sequence[str], files: Sequence[str] = FILES[:1]
) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Read the configuration of an earlier run; return the whole configuration, and the nodes of `groups` in it.

    Args:
        directory: folder of the run.
        argument: config key that names the run, for error messages.
        trust: code that the user trusts in the earlier run's configuration.
        groups: config groups whose nodes are returned.
        files: files that the folder must have.

    Raises:
        InputError: the nodes name code that the user does not trust, or a file is missing.
    """
    from lmd.core.checks import InputError

    for name in files:
        if not (directory / name).is_file():
            raise InputError(f"{argument} = '{directory}' is not a run: there is no '{directory}/{name}'.")
    before = read_yaml(directory / FILES[0], argument)
    return before, trust.parts(before, f"{argument}: '{directory / FILES[0]}'", groups)


def count_of(run: str | Path) -> int:
    """Number of landmarks of the run whose folder is `run`."""
    from lmd.core.tables import read_table

    return len(read_table(Path(run) / FILES[1], name="run").lines)


def compared(cfg: DictConfig) -> dict[str, DictConfig]:
    """Configuration for each entry of `deployments`, by the name of the entry.

    Without entries, the result has only the configuration of the command line. An entry is an option of
    `conf/deployment`, or a text `NAME: OPTION OVERRIDES` that gives the entry a name and overrides. If the command line
    gives `deployment.path`, it applies to entries that read files; `deployment.count` applies to all other entries.

    Raises:
        InputError: an entry is refused.
    """
    from lmd.core.checks import InputError

    if cfg.deployments is None:
        return {choices()["deployment"]: cfg}
    entries = [str(entry) for entry in cfg.deployments] if OmegaConf.is_list(cfg.deployments) else []
    if not entries or not all(entry.split() for entry in entries):
        raise InputError(f"deployments must list at least one option of conf/deployment, got {cfg.deployments!r}.")
    composed: dict[str, DictConfig] = {}
    count = [] if cfg.run is None else [(COUNT[:-1], f"{COUNT}{count_of(str(cfg.run))}")]
    given = [*count, *((key, text) for key, text in task_overrides() if key not in ("deployment", "deployments"))]
    kinds = set()
    for entry in entries:
        first, *rest = entry.split()
        name, option, own = (first[:-1], rest[0], rest[1:]) if first.endswith(":") and rest else (first, first, rest)
        if name in composed:
            raise InputError(f"deployments has {name!r} twice: give them names, e.g. 'mine: {entry}'.")
        if not NAME.fullmatch(name):
            raise InputError(f"deployments: the name {name!r} must be of letters, digits, _, - and dots.")
        kinds.add(left_out := PATH if option in COUNTED else COUNT[:-1])
        shared = [text for key, text in given if key != left_out and not (key == PATH and option == OPTION)]
        words = [*shared, f"deployment={option}", *own]
        composed[name] = _final(recompose(str(HydraConfig.get().job.config_name), words, "deployments", entry))
    if kinds == {PATH} and (unused := [text for key, text in given if key == PATH]):
        raise InputError(f"{unused[0]} belongs to none of the deployments {', '.join(composed)}.")
    return composed
