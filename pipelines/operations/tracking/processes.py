"""Which process a run belongs to, so that a run whose process is gone can be told from one that runs."""

import os
import re
import socket
from pathlib import Path

PROC = Path("/proc")
BOOT = PROC / "sys/kernel/random/boot_id"
# What a run of this version writes: a store may hold anything, and what earlier ones wrote tells nothing here.
IDENTITY = re.compile(r"\d{1,9} \d{1,19} [0-9a-f-]{36}" if BOOT.is_file() else r"\d{1,9} \d{1,19}\.\d\d")


def this_process() -> dict[str, str]:
    """Host, number and beginning of this process, as tags of a run."""
    return {"host": socket.gethostname(), "process": _identity(os.getpid())}


def is_gone(tags: dict[str, str]) -> bool:
    """Whether the process in these tags has ended; False where it belongs to another host, or to none."""
    import psutil

    process = tags.get("process", "")
    if tags.get("host") != socket.gethostname() or not IDENTITY.fullmatch(process):
        return False
    try:
        return _identity(int(process.partition(" ")[0])) != process
    except (psutil.NoSuchProcess, FileNotFoundError, ProcessLookupError):
        return True


def _identity(number: int) -> str:
    """A process, by its number and when it began: on Linux since which boot, as the clock may be set meanwhile."""
    if BOOT.is_file():
        began = (PROC / str(number) / "stat").read_text().rpartition(")")[2].split()[19]  # ticks; proc(5) counts from 1
        return f"{number} {began} {BOOT.read_text().strip()}"
    import psutil

    return f"{number} {psutil.Process(number).create_time():.2f}"
