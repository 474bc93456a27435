"""Optional packages, imported at their first use, and messages for packages, modules and classes that are missing."""

import importlib
import os
import sys
from pathlib import Path
from typing import Any

from lmd.core.checks import InputError, failure

# Optional packages, and the extra of `lmd` that installs each.
EXTRAS = {
    "cma": "optimisers",
    "cv2": "detection",
    "gtsam": "estimators",
    "nevergrad": "nevergrad",
    "pymoo": "optimisers",
    "rosbags": "bags",
}


def optional(package: str, extra: str) -> Any:
    """Import the package named `package`, which `pip install lmd[extra]` installs.

    Raises:
        InputError: the package is not installed.
    """
    try:
        return importlib.import_module(package)
    except ImportError:
        raise missing(package, extra) from None


def missing(package: str, extra: str) -> InputError:
    """Error for a package that is not installed; its message has the command that installs it."""
    root, python = Path(__file__).parents[2], _short(sys.executable)
    source = "'lmd"
    if (root / "constraints.txt").exists():  # a checkout
        source = f"--constraint {_short(root / 'constraints.txt')} --editable '{_short(root)}"
    return InputError(f"this needs the package {package}: {python} -m pip install {source}[{extra}]'.")


def missing_of(error: BaseException | None) -> InputError | None:
    """Error made by `missing` if a missing optional package, one of `EXTRAS`, caused `error`; None otherwise."""
    while error is not None and not isinstance(error, ModuleNotFoundError):
        error = error.__cause__ or error.__context__
    name = getattr(error, "name", None) or ""
    return missing(name, EXTRAS[name]) if name in EXTRAS else None


def lack_of(target: str) -> str:
    """Reason, for a message, why the dotted path `target` names no class or function, such as a missing module."""
    found, parts = None, target.split(".")
    for i, part in enumerate(parts):
        whole = ".".join(parts[: i + 1])
        try:
            found = getattr(found, part) if hasattr(found, part) else importlib.import_module(whole)
        except ModuleNotFoundError as error:
            if not f"{whole}.".startswith(f"{error.name}."):  # an alias of a module is not a package
                return failure(error)
            return f"{'.'.join(parts[:i])} has no {part}" if i else f"there is no module {part}"
        except Exception as error:  # a user's module may raise any error
            return f"{target} cannot be imported: {failure(error)}"
    return f"{target} is neither a class nor a function"


def _short(path: str | Path) -> str:
    """Path relative to the working directory; a path outside that directory is unchanged."""
    relative = os.path.relpath(path)
    return str(path) if relative.startswith("..") else relative
