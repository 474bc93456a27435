"""Files of arrays by NumPy (`.npz`) and MATLAB (`.mat` before version 7.3) as keys and plain values."""

import io
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np

from lmd.core.checks import InputError
from lmd.core.files import read_bytes
from lmd.formats.mat_files import MatFile

# Largest array that is kept, entries (files of calibrations also hold images and points), and deepest structure of
# MATLAB.
LARGEST_ARRAY, DEEPEST = 256, 6
ZIP, NUMPY, HDF5, MATLAB = b"PK\x03\x04", b"\x93NUMPY", b"\x89HDF", b"MATLAB 5.0"
HDF5_AT = 512  # offset of HDF5 in files of MATLAB, after a text, bytes
PICKLE = (b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")
SAVEZ = "numpy.savez('lens.npz', mtx=mtx, dist=dist)"


def arrays_of(path: Any, name: str, largest: float) -> Mapping[str, Any] | None:
    """Small arrays of a file by name, as numbers, texts, lists and mappings; None for a file of another kind.

    Args:
        path: path of the file.
        name: argument that gave the path, for messages.
        largest: greatest size of the file, and of its expanded content, bytes.

    Raises:
        InputError: the file cannot be read, is too large, holds objects, or has a format that is not supported.
    """
    content = read_bytes(path, name, largest)
    start, where = content[:HDF5_AT], f"{name}: {str(path)!r}"
    if start.startswith(PICKLE):
        raise InputError(f"{where} is a pickle of Python, which may run code: write it by {SAVEZ}.", name)
    if start.startswith(NUMPY):
        raise InputError(f"{where} is a single array of NumPy, without the other half: write both by {SAVEZ}.", name)
    if start.startswith(HDF5) or content[HDF5_AT : HDF5_AT + 4] == HDF5:
        raise InputError(
            f"{where} is a file of MATLAB's version 7.3: save('lens.mat', 'params', '-v7') with params = "
            "toStruct(cameraParams).",
            name,
        )
    if not start.startswith((ZIP, MATLAB)):
        return None
    try:
        return _npz(content, largest) if start.startswith(ZIP) else _mat(content, largest)
    except InputError as error:
        raise InputError(f"{where} {error}", name) from None
    except Exception as error:  # a broken file may raise anything
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{where} cannot be read as arrays ({reason}).", name) from None


def _npz(content: bytes, largest: float) -> dict[str, Any]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        if sum(part.file_size for part in archive.infolist()) > largest:
            raise InputError(f"expands to more than {largest:.4g} bytes.")
        names = [part.filename for part in archive.infolist() if part.filename.endswith(".npy")]
    if not names:
        raise InputError("is an archive without arrays of NumPy.")
    found = {}
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        for name in (name.removesuffix(".npy") for name in names):
            try:
                array = arrays[name]
            except ValueError as error:  # objects of Python are not loaded
                if "pickle" not in str(error):
                    raise
                continue
            if array.size <= LARGEST_ARRAY:
                found[name] = array.tolist()
    if not found:
        raise InputError(f"holds only objects of Python or large arrays: write it by {SAVEZ}.")
    return found


def _mat(content: bytes, largest: float) -> dict[str, Any]:
    keys = MatFile(content, int(largest), LARGEST_ARRAY, DEEPEST).keys()
    if not keys:
        raise InputError(
            "holds objects of MATLAB, which only MATLAB reads: params = toStruct(cameraParams) and "
            "save('lens.mat', 'params', '-v7')."
        )
    return keys
