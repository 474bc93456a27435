"""Configurations, as Hydra composes them for a command."""

import copy
import pickle
from collections import defaultdict
from functools import cache

from hydra import compose, initialize_config_dir
from hydra._internal import defaults_list
from hydra._internal.hydra import Hydra
from hydra._internal.sources_registry import SourcesRegistry
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.plugins import Plugins
from omegaconf import _utils, base

import pipelines.composing
from pipelines.app import CONF


def composed(pipeline, *overrides, **more):
    """The configuration of a pipeline, with Hydra's part where `more` asks for it; composing takes some 60 ms."""
    if not more:
        return pipelines.composing.compose(pipeline, *overrides)
    with initialize_config_dir(CONF, version_base="1.3"):
        return compose(pipeline, list(overrides), **more)


def _compose_sooner():
    """Spare what is read, parsed or asked for again, and copies of what nobody changes: a third of composing."""
    Plugins.instance()  # registers Hydra's own loaders
    resources = SourcesRegistry.instance().types["pkg"]  # Hydra has executed its module anew, so it is no import
    load, parse_rule = resources.load_config, OverridesParser.parse_rule
    choices = defaults_list._create_interpolation_map
    read, parsed = {}, {}

    def load_once(self, config_path):
        key = self.provider, self.path, config_path
        if key not in read:
            read[key] = pickle.dumps(load(self, config_path))  # Hydra changes what it gets
        return pickle.loads(read[key])

    def parse_once(self, *text):
        if text not in parsed:
            parsed[text] = parse_rule(self, *text)
        return copy.deepcopy(parsed[text])  # Hydra writes the source of an override into the override

    def choices_if_needed(overrides, defaults, self_added):
        return choices(overrides, defaults, self_added) if any(d.is_interpolation() for d in defaults) else None

    def copied(self, memo):
        """Of what a node knows of itself only flags and the cache of resolvers ever change."""
        new = object.__new__(type(self))
        caches = copy.deepcopy(self.resolver_cache, memo) if self.resolver_cache else defaultdict(dict)
        new.__dict__.update(self.__dict__, flags=dict(self.flags or {}), resolver_cache=caches)
        return new

    resources.load_config = load_once
    OverridesParser.parse_rule = parse_once
    defaults_list._create_interpolation_map = choices_if_needed
    base.Metadata.__deepcopy__ = copied
    base.parse = _utils.parse = cache(base.parse)  # of interpolations, into trees that are only walked


def _look_for_a_mode_only_where_one_may_be_set():
    """Hydra composes everything once more to see whether a configuration says that it is a sweep."""
    look = Hydra.get_mode
    may_set = ("experiment=", "hydra.mode", "hydra.searchpath", "+hydra", "hydra/")

    def get_mode(self, config_name, overrides):
        own = any(source.provider == "command-line" for source in self.config_loader.get_sources())
        return look(self, config_name, overrides) if own or any(o.startswith(may_set) for o in overrides) else None

    Hydra.get_mode = get_mode


_compose_sooner()
_look_for_a_mode_only_where_one_may_be_set()
