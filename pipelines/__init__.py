"""Command-line entry points: thin Hydra applications over `lmd`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from omegaconf import DictConfig

GARBAGE = 1_000_000  # allocations between two garbage collections; with Python's 700 they take a quarter of all imports

try:
    import _signal  # type: ignore[import-not-found]  # built in; an interrupt during `import signal` prints a traceback
    import gc
    import os
    import sys

    # The process of an application handles signals from here on. With -m, its name is not in sys.argv yet.
    if sys.argv[:1] == ["-m"] or os.path.basename("".join(sys.argv[:1])).startswith("lmd-"):
        _signal.signal(_signal.SIGINT, _signal.SIG_DFL)  # no traceback while the handler is imported
        gc.set_threshold(GARBAGE)
        os.environ["MPLBACKEND"] = "agg"  # pictures go to files, and the backend of IPython may not be installed

        from .operations.signals import stop

        stop.listen()

    from importlib.util import find_spec

    if find_spec("hydra") is None:  # `pip install lmd` installs only the library
        from lmd.core.optional import missing

        raise SystemExit(f"error: {missing('hydra-core', 'pipelines')}")
except KeyboardInterrupt:
    raise SystemExit(130) from None


def compose(command: str, *overrides: str) -> "DictConfig":
    """Compose the configuration of a command with overrides such as `seed=1`, see `composing.compose`."""
    from .composing import compose as composed

    return composed(command, *overrides)
