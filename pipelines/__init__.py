"""Command-line entry points: thin Hydra applications over `lmd`."""

try:
    import _signal  # type: ignore[import-not-found]  # built in; an interrupt during `import signal` prints a traceback
    import os
    import sys

    # The process of an application handles signals from here on; under -m its name is not in sys.argv yet.
    if sys.argv[:1] == ["-m"] or os.path.basename("".join(sys.argv[:1])).startswith("lmd-"):
        _signal.signal(_signal.SIGINT, _signal.SIG_DFL)  # no traceback while the handler is imported

        from .operations.signals import stop

        stop.listen()

    from importlib.util import find_spec

    if find_spec("hydra") is None:  # `pip install lmd` alone installs the library
        from lmd.core.optional import missing

        raise SystemExit(f"error: {missing('hydra-core', 'pipelines')}")
except KeyboardInterrupt:
    raise SystemExit(130) from None
