"""What a sweep and its jobs keep on disk, so that processes and machines can share it and a later sweep can go on."""

import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf, read_write

JOB_VARIABLE = "LMD_JOB"  # tells a process which job folder it works for
SLUG_LENGTH = 100


def _save(path: Path, document: Mapping[str, Any]) -> None:
    partial = path.with_suffix(f".{os.getpid()}.partial")
    partial.write_text(json.dumps(document, indent=2) + "\n")
    os.replace(partial, path)


@dataclass(frozen=True)
class Sweep:
    """A sweep, as `sweep.json` in its folder describes it.

    Args:
        name: the experiment it runs, or what it varies.
        varied: the config keys that differ between its jobs.
        run_id: its tracked run, the parent of its jobs' runs; None where nothing is recorded.
    """

    name: str
    varied: tuple[str, ...]
    run_id: str | None

    def save(self, folder: Path) -> None:
        """Write it, whole or not at all."""
        folder.mkdir(parents=True, exist_ok=True)
        _save(folder / "sweep.json", asdict(self))

    @classmethod
    def load(cls, folder: Path) -> "Sweep | None":
        """Read it; None where there is none."""
        path = folder / "sweep.json"
        if not path.is_file():
            return None
        values = json.loads(path.read_text())
        return cls(values["name"], tuple(values["varied"]), values["run_id"])


@dataclass(frozen=True)
class Job:
    """A job of a sweep, as `job.json` in its folder describes it.

    Args:
        sweep: the name of its sweep.
        parent: the tracked run of its sweep, if any.
        number: its place in the sweep, from 0.
        overrides: its overrides, as on the command line.
        varied: those among them that differ from job to job, as `{"objective.n": "2"}`.
        status: `running`, `finished`, `interrupted`, `failed` by its own doing, or `killed`.
        value: what the finished job returned.
        reason: why it did not finish.
        seconds: wall time it took.
    """

    sweep: str
    parent: str | None
    number: int
    overrides: tuple[str, ...]
    varied: Mapping[str, str]
    status: str = "running"
    value: float | None = None
    reason: str = ""
    seconds: float = 0.0

    @property
    def label(self) -> str:
        """What tells it from the other jobs."""
        return " ".join(f"{key}={value}" for key, value in self.varied.items()) or " ".join(self.overrides)

    def tags(self, folder: Path) -> dict[str, str]:
        """The tags of its tracked run that lead to the sweep."""
        from ..tracking import PARENT_TAG

        return {"sweep": self.sweep, "job": folder.name} | ({PARENT_TAG: self.parent} if self.parent else {})

    def save(self, folder: Path) -> None:
        """Write it, whole or not at all."""
        _save(folder / "job.json", asdict(self))

    @classmethod
    def load(cls, folder: Path) -> "Job | None":
        """Read it; None where there is none."""
        path = folder / "job.json"
        if not path.is_file():
            return None
        values = json.loads(path.read_text())
        return cls(**(values | {"overrides": tuple(values["overrides"])}))


def current_job() -> tuple[Path, Job] | None:
    """The job this process works for and its folder; None outside a sweep."""
    folder = os.environ.get(JOB_VARIABLE)
    job = Job.load(Path(folder)) if folder else None
    return (Path(folder), job) if folder and job else None


@contextmanager
def held(folder: Path, wait: bool = True) -> Iterator[int | None]:
    """Hold a job's folder for this process and those that inherit the descriptor; None if another holds it.

    Args:
        folder: the job's folder.
        wait: whether to wait for the other.
    """
    import fcntl

    with (folder / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if not wait:
                yield None
                return
            print(f"{folder} is still being worked on by another process; waiting for it", flush=True)
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield lock.fileno()


def reason_of(error: BaseException) -> str:
    """What ended a run, in one line."""
    from lmd.checks import InputError

    if isinstance(error, SystemExit) and not isinstance(error.code, str):
        return f"exited with code {error.code or 0} before it had finished"
    text = " ".join(str(error).split())
    return text if isinstance(error, InputError | SystemExit) else f"{type(error).__name__}: {text}".rstrip(": ")


def key_and_value(override: str) -> tuple[str, str]:
    """`+objective.n=2` as (`objective.n`, `2`)."""
    key, _, value = override.partition("=")
    return key.lstrip("+~"), value


def override_tags(overrides: Sequence[str]) -> dict[str, str]:
    """Overrides as the tags of a tracked run, all in one and each by itself."""
    each = {f"override.{key}": value for key, value in map(key_and_value, overrides)}
    return {"overrides": " ".join(overrides)} | each


def slug(text: str) -> str:
    """`text` in characters that need no quotes in a path or an override."""
    return re.sub(r"[^\w.-]+", "-", text)[:SLUG_LENGTH].strip("-.")


def _digest(*parts: Any) -> str:
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:8]


def _settings(root: DictConfig) -> Any:
    """The resolved configuration without Hydra's own."""
    return OmegaConf.to_container(
        OmegaConf.masked_copy(root, [str(key) for key in root if key != "hydra"]), resolve=True
    )


def swept(root: DictConfig) -> list[str]:
    """The overrides of a sweep: the stored ones, then those of the command line."""
    return [f"{key}={value}" for key, value in (root.hydra.sweeper.get("params") or {}).items()] + list(
        root.hydra.overrides.task
    )


def varied_keys(overrides: Sequence[str]) -> tuple[str, ...]:
    """The keys of those `overrides` that have more than one value."""
    from hydra.core.override_parser.overrides_parser import OverridesParser

    parsed = OverridesParser.create().parse_overrides(list(overrides))
    return tuple(dict.fromkeys(str(o.key_or_group) for o in parsed if o.is_sweep_override()))


def sweep_name(root: DictConfig) -> str:
    """The experiment a sweep runs, or else what it varies."""
    experiment = root.hydra.runtime.choices.get("experiment")
    return str(experiment or slug("_".join(varied_keys(swept(root)))) or "sweep")


def sweep_folder(*, _root_: DictConfig) -> str:
    """Name of a sweep's folder: the same for the same command, another for any other."""
    return f"{slug(sweep_name(_root_))}-{_digest(_settings(_root_), sorted(swept(_root_)))}"


def job_folder(*, _root_: DictConfig) -> str:
    """Name of a job's folder below that of its sweep: the same for the same configuration."""
    sweep = Sweep.load(Path(_root_.hydra.sweep.dir))
    values = [key_and_value(override) for override in _root_.hydra.overrides.task]
    kept = [f"{key.split('.')[-1]}-{value}" for key, value in values if sweep and key in sweep.varied]
    return "_".join([*filter(None, [slug("_".join(kept))]), _digest(_settings(_root_))])


def quoted(path: Path) -> str:
    """A path as the value of an override."""
    escaped = str(path).replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"


def pin_sweep_folder(config: DictConfig) -> Path:
    """Give the jobs of a sweep the folder of the sweep, which their own configuration cannot tell; returns it."""
    folder = Path(config.hydra.sweep.dir)
    with read_write(config.hydra):
        config.hydra.sweep.dir = str(folder)
        config.hydra.overrides.hydra.append(f"hydra.sweep.dir={quoted(folder)}")  # from these the jobs are composed
    return folder


OmegaConf.register_new_resolver("lmd.sweep_folder", sweep_folder, replace=True)
OmegaConf.register_new_resolver("lmd.job_folder", job_folder, replace=True)
