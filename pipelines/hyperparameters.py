"""Defaults of the classes of optimisers and cameras, added to their configurations.

A file in `conf/optimiser` or `conf/camera`, or a user's file, has only the values that differ from the defaults of its
class. The other arguments of the class are added when Hydra loads the file, so that `--cfg job` shows all arguments, a
run records them, and `optimiser.population=12` overrides one of them.

The module replaces Hydra's loader of files in a private registry, because no public interface covers users' files:
- Structured configs and hydra-zen's builds are registered by name; a YAML file would have to name such a config in its
  `defaults`.
- A `ConfigSource` plugin needs a scheme of its own, but `--config-dir` and plain paths are `file://`, and the registry
  refuses a second class for a scheme.
- Arguments cannot be added after composition, as Hydra refuses overrides of keys that no file has.
"""

import inspect
import pickle
import sys
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

from hydra._internal.core_plugins import file_config_source
from hydra._internal.sources_registry import SourcesRegistry
from hydra.core.plugins import Plugins
from hydra.plugins.config_source import ConfigResult
from omegaconf import DictConfig, OmegaConf

GROUPS = ("optimiser", "camera")
SET_ELSEWHERE = ("seed", "encoding", "rng", "x0")  # arguments set by top-level keys or by wrappers of SciPy
HELP = {"--help", "-h"}


class FileConfigSource(file_config_source.FileConfigSource):
    """Loader of files for Hydra, which completes the files of `GROUPS`.

    The class has the name of the class that it replaces, so that Hydra in another process finds it registered.
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
            if not builds_on:  # a file that builds on others changes keys of completed files
                loaded.config = OmegaConf.merge(completed(file), file)
        return loaded

    def _read(self, config_path: str) -> ConfigResult:
        path = Path(self.path, self._normalize_file_name(config_path))
        if not path.is_file():
            return super().load_config(config_path)  # raises Hydra's error
        state = path.stat()
        key = (self.provider, path, state.st_mtime_ns, state.st_size)
        if key not in self._read_before:
            self._read_before[key] = pickle.dumps(super().load_config(config_path))  # Hydra changes its results
        return pickle.loads(self._read_before[key])  # type: ignore[no-any-return]


def completed(node: DictConfig) -> dict[str, Any]:
    """Defaults of the class of a node and of its inner nodes; empty if the node has no class."""
    from hydra._internal.utils import _locate  # the public function logs its errors

    written = OmegaConf.to_container(node, resolve=False)
    assert isinstance(written, dict)
    try:
        parameters = inspect.signature(_locate(str(written.get("_target_")))).parameters
    except Exception:  # any error of an import is reported when the object is built
        parameters = MappingProxyType({})
    values = {name: _plain(parameter.default) for name, parameter in parameters.items() if name not in SET_ELSEWHERE}
    inner = {
        str(name): completed(below)
        for name, below in node.items_ex(resolve=False)
        if isinstance(below, DictConfig) and "_target_" in below
    }
    return {name: value for name, value in (values | inner).items() if value is not inspect.Parameter.empty}


def _plain(value: Any) -> Any:
    """Default as a value of a configuration; `Parameter.empty` if that is impossible."""
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
