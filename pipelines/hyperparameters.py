"""The defaults of the classes of optimisers and cameras, as keys of their configurations.

A file in `conf/optimiser` or `conf/camera`, or of a user, has only the keys that differ from its class. The other
arguments of the class are added when Hydra loads the file, so that `--cfg job` shows them, a run records them, and
`optimiser.population=12` overrides them.

This replaces Hydra's loader of files in its private registry, because no public way covers files of users:
- Structured configs and hydra-zen's builds are registered by name; a YAML file has to name one in its `defaults`.
- A `ConfigSource` plugin needs a scheme of its own, but `--config-dir` and plain paths are `file://`, and the registry
  refuses a second class for a scheme.
- After composition it is too late: Hydra has refused overrides of keys that no file has.
"""

import inspect
import pickle
import sys
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any, ClassVar

from hydra._internal.core_plugins import file_config_source
from hydra._internal.sources_registry import SourcesRegistry
from hydra.core.plugins import Plugins
from hydra.plugins.config_source import ConfigResult
from omegaconf import DictConfig, OmegaConf

GROUPS = ("optimiser", "camera")
SET_ELSEWHERE = ("seed", "encoding", "rng", "x0")  # arguments that keys at the top or wrappers of SciPy set
HELP = {"--help", "-h"}


class FileConfigSource(file_config_source.FileConfigSource):
    """Hydra's loader of files, which completes those of `GROUPS`.

    It has the name of the class that it replaces, by which Hydra finds in another process that there is one already.
    """

    _read_before: ClassVar[dict[tuple[Any, ...], bytes]] = {}

    def load_config(self, config_path: str) -> ConfigResult:
        """Load a file; see `hydra.plugins.config_source.ConfigSource`.

        Hydra composes twice for each command; a file is read and parsed once.
        """
        loaded = self._read(config_path)
        file = loaded.config
        if config_path.split("/")[0] in GROUPS and not HELP.intersection(sys.argv) and isinstance(file, DictConfig):
            builds_on = [entry for entry in file.get("defaults", []) if not str(entry).startswith("{'override ")]
            if not builds_on:  # otherwise those files are completed, and this one changes them
                loaded.config = OmegaConf.merge(completed(file), file)
        return loaded

    def _read(self, config_path: str) -> ConfigResult:
        path = Path(self.path, self._normalize_file_name(config_path))
        if not path.is_file():
            return super().load_config(config_path)  # raises
        state = path.stat()
        key = (self.provider, path, state.st_mtime_ns, state.st_size)
        if key not in self._read_before:
            self._read_before[key] = pickle.dumps(super().load_config(config_path))  # Hydra changes its results
        return pickle.loads(self._read_before[key])  # type: ignore[no-any-return]


def completed(node: DictConfig) -> dict[str, Any]:
    """The defaults of the class of a node and of the nodes in it; empty if it has no class."""
    from hydra._internal.utils import _locate  # the public function logs its errors

    written = OmegaConf.to_container(node, resolve=False)
    assert isinstance(written, dict)
    try:
        parameters = inspect.signature(_locate(str(written.get("_target_")))).parameters
    except Exception:  # any error of an import is reported when the object is built
        return {}
    values = {name: _plain(parameter.default) for name, parameter in parameters.items() if name not in SET_ELSEWHERE}
    inner = {
        str(name): completed(below)
        for name, below in node.items_ex(resolve=False)
        if isinstance(below, DictConfig) and "_target_" in below
    }
    return {name: value for name, value in (values | inner).items() if value is not inspect.Parameter.empty}


def _plain(value: Any) -> Any:
    """A default as a value of a configuration; `Parameter.empty` if it cannot be one."""
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, Mapping):
        values = {str(key): _plain(inner) for key, inner in value.items()}
        return inspect.Parameter.empty if inspect.Parameter.empty in values.values() else values
    if isinstance(value, tuple | list):
        listed = [_plain(inner) for inner in value]
        return inspect.Parameter.empty if inspect.Parameter.empty in listed else listed
    return value if value is None or isinstance(value, bool | int | float | str) else inspect.Parameter.empty


Plugins.instance()  # registers Hydra's own loader of files
SourcesRegistry.instance().types[FileConfigSource.scheme()] = FileConfigSource
