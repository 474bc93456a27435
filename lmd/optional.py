"""Packages that only some uses need: imported when first used, with one sentence when they are missing."""

import importlib
from typing import Any

from lmd.checks import InputError


def optional(package: str, extra: str) -> Any:
    """The package named `package`, which pip's extra `lmd[extra]` installs.

    Raises:
        InputError: it is not installed.
    """
    try:
        return importlib.import_module(package)
    except ImportError:
        raise InputError(f"this needs the package {package}: pip install 'lmd[{extra}]'.") from None
