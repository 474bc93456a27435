"""Optional packages: imported at their first use; a missing package raises an error with the install command."""

import importlib
import os
import sys
from pathlib import Path
from typing import Any

from lmd.core.checks import InputError

# Optional packages, and the extra of `lmd` that installs each.
EXTRAS = {
    "cma": "optimisers",
    "cv2": "detection",
    "gtsam": "estimators",
    "hydra_plugins.hydra_joblib_launcher": "sweeps",
    "hydra_plugins.hydra_submitit_launcher": "sweeps",
    "nevergrad": "optimisers",
    "niapy": "optimisers",
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
    """Result of `missing` if an error was caused by the absence of a package of `EXTRAS`, else None."""
    while error is not None and not isinstance(error, ModuleNotFoundError):
        error = error.__cause__ or error.__context__
    name = getattr(error, "name", None) or ""
    return missing(name, EXTRAS[name]) if name in EXTRAS else None


def _short(path: str | Path) -> str:
    """Path relative to the working directory; a path outside that directory is unchanged."""
    relative = os.path.relpath(path)
    return str(path) if relative.startswith("..") else relative
