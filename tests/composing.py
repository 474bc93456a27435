"""Configurations, as Hydra composes them for a command."""

import pickle

from hydra import compose, initialize_config_dir
from hydra._internal import defaults_list
from hydra._internal.core_plugins.importlib_resources_config_source import ImportlibResourcesConfigSource

from pipelines.app import CONF


def composed(pipeline, *overrides, **more):
    """The configuration of a pipeline; composing takes some 60 ms."""
    with initialize_config_dir(CONF, version_base="1.3"):
        return compose(pipeline, list(overrides), **more)


def _compose_sooner():
    """Spare what takes a third of composing: reading Hydra's own files anew, and choices that no default refers to."""
    load, read = ImportlibResourcesConfigSource.load_config, {}
    choices = defaults_list._create_interpolation_map

    def load_once(self, config_path):
        key = self.provider, self.path, config_path
        if key not in read:
            read[key] = pickle.dumps(load(self, config_path))  # Hydra changes what it gets
        return pickle.loads(read[key])

    def choices_if_needed(overrides, defaults, self_added):
        return choices(overrides, defaults, self_added) if any(d.is_interpolation() for d in defaults) else None

    ImportlibResourcesConfigSource.load_config = load_once
    defaults_list._create_interpolation_map = choices_if_needed


_compose_sooner()
