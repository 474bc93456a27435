"""Command-line entry points: thin Hydra applications over `lmd`."""

try:
    import _signal  # type: ignore[import-not-found]  # built in: while `signal` is imported, an interrupt is a traceback
    import os
    import sys

    # Where this process is one of the applications (python's -m has not named it yet), a signal is heard from here on.
    if sys.argv[:1] == ["-m"] or os.path.basename("".join(sys.argv[:1])).startswith("lmd-"):
        _signal.signal(_signal.SIGINT, _signal.SIG_DFL)  # no traceback while what hears it is imported

        from .operations.signals import stop

        stop.listen()

    from importlib.util import find_spec

    if find_spec("hydra") is None:  # `pip install lmd` alone installs the library
        from lmd.core.optional import missing

        raise SystemExit(f"error: {missing('hydra-core', 'pipelines')}")
except KeyboardInterrupt:  # it came on these lines
    raise SystemExit(130) from None
