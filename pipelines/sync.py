"""Send the records that runs could not send to the store: `python -m pipelines.sync [folder=outputs]`.

A run whose tracking store stops answering continues, and keeps its record in a journal in its folder.
"""

import shlex
import sys
from pathlib import Path

from omegaconf import DictConfig

from .command import Command, alone
from .trust import PAGE


def sync(cfg: DictConfig) -> bool:
    """Send all journals below the configured folder; False if a journal could not be sent.

    Raises:
        InputError: there is no such folder.
    """
    from lmd.core.checks import InputError, boolean, printable

    from .operations.tracking.journal import FILE, Journal, hand_in

    folder, yes = Path(str(cfg.folder)), boolean("yes", cfg.yes)
    if not folder.is_dir():
        raise InputError(f"folder = {str(cfg.folder)!r} is no folder.")
    paths, failed = sorted(folder.rglob(FILE)), False
    for path in paths:
        try:
            journal = Journal.of(path.parent, elsewhere=yes)
            print(printable(hand_in(journal, _destination(journal.store, cfg, yes))), flush=True)
        except InputError as error:
            print(printable(f"error: {path}: {error}"), file=sys.stderr)
            failed = True
    if not paths:
        print(f"nothing to hand in below {folder}")
    return not failed


def _destination(given: str | None, cfg: DictConfig, yes: bool) -> str:
    """Address of the store for a journal of a run with the store address `given`.

    Raises:
        InputError: `given` is not the configured address, and the user has not confirmed it.
    """
    from lmd.core.checks import InputError

    if cfg.uri is not None:
        return str(cfg.uri)
    configured = cfg.tracking.get("uri")  # tracking=none has no address
    if given not in (None, configured) and not yes:
        raise InputError(f"it is for {given!r}, and not for {configured!r}, your tracking.uri; if you know it, add "
                         f"{shlex.quote(f'uri={given}')} and yes=true ({PAGE}).")  # fmt: skip
    return str(given or configured)


def _sync_or_fail(cfg: DictConfig) -> None:
    if not sync(cfg):
        sys.exit(1)


main = Command("sync", _sync_or_fail, alone)

if __name__ == "__main__":
    main()
