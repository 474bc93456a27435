"""Hand in what runs could not record: `python -m pipelines.sync [folder=outputs]`.

A run whose tracking store stops to answer goes on, and keeps what it has to record in a journal in its folder.
"""

import sys
from pathlib import Path

from omegaconf import DictConfig

from .app import application, ends_reported


@application("sync")
def main(cfg: DictConfig) -> None:
    """Hand in all journals below a folder; exits with 1 if one could not be."""
    with ends_reported():
        if not sync(cfg):
            sys.exit(1)


def sync(cfg: DictConfig) -> bool:
    """Hand in all journals below the configured folder; whether all could be.

    Raises:
        InputError: there is no such folder.
    """
    from lmd.checks import InputError

    from .tracking.hand_in import hand_in
    from .tracking.journal import Journal

    folder = Path(str(cfg.folder))
    if not folder.is_dir():
        raise InputError(f"folder = {str(cfg.folder)!r} is no folder.")
    journals, failed = list(Journal.below(folder)), False
    for journal in journals:
        try:
            print(hand_in(journal, cfg.uri), flush=True)
        except InputError as error:
            print(f"error: {journal.path}: {error}", file=sys.stderr)
            failed = True
    if not journals:
        print(f"nothing to hand in below {folder}")
    return not failed


if __name__ == "__main__":
    main()
