"""Joint covariance of the tags of a surveyed map, beside its `map.csv`: `map.npz`.

Errors of neighbouring tags in a map are alike, so the covariance of each tag by itself, as `map.csv` has it, misjudges
what a map does to a pose.
"""

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError, IntArray
from lmd.core.files import read_bytes
from lmd.core.memory import check_memory

FILE = "map.npz"
LARGEST = 1 << 30  # greatest size of a file, bytes


def write_map_covariance(path: Path, ids: IntArray, covariance: FloatArray) -> None:
    """Write the covariance of the twists of tags in their own frames, rotations before shifts.

    Args:
        path: file.
        ids: `(K,)` ids of the tags, ascending.
        covariance: `(6 K, 6 K)`, of which the upper triangle is written, row by row.
    """
    upper = covariance[np.triu_indices(len(covariance))]
    with path.open("wb") as file:
        np.savez_compressed(file, ids=ids, upper=upper.astype(np.float32))


def read_map_covariance(path: Any, name: str) -> tuple[IntArray, FloatArray]:
    """Read ids `(K,)`, ascending, and covariance `(6 K, 6 K)`.

    Raises:
        InputError: the file cannot be read, or is no covariance of a map.
    """
    content = read_bytes(path, name, LARGEST)
    refused = InputError(f"{name}: {str(path)!r} is no covariance of a map, as a survey writes it.", name)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            check_memory(4.0 * sum(part.file_size for part in archive.infolist()), f"{name}: {str(path)!r}")
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            ids, upper = arrays["ids"], arrays["upper"]
    except InputError:
        raise
    except Exception:  # a broken file may raise anything
        raise refused from None
    size = 6 * len(ids) if ids.ndim == 1 else 0
    if ids.dtype.kind != "i" or upper.dtype.kind != "f" or not size or upper.shape != (size * (size + 1) // 2,):
        raise refused
    found = np.zeros((size, size))
    found[np.triu_indices(size)] = upper
    found += np.triu(found, 1).T
    if not np.isfinite(found).all() or (np.diag(found) < 0.0).any() or (np.diff(ids) <= 0).any():
        raise refused
    return ids.astype(np.int64), found
