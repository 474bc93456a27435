"""Which process a run belongs to, so that a run whose process is gone can be told from one that runs."""

import os
import socket

SAME = 1.0  # seconds; two processes of one number began further apart


def this_process() -> dict[str, str]:
    """Host, number and beginning of this process, as tags of a run."""
    import psutil

    return {"host": socket.gethostname(), "process": f"{os.getpid()} {psutil.Process().create_time():.2f}"}


def is_gone(tags: dict[str, str]) -> bool:
    """Whether the process in these tags has ended; False where it belongs to another host, or to none."""
    import psutil

    if tags.get("host") != socket.gethostname() or "process" not in tags:
        return False
    try:
        number, began = tags["process"].split()
        return bool(abs(psutil.Process(int(number)).create_time() - float(began)) > SAME)
    except psutil.NoSuchProcess:
        return True
    except ValueError:  # nothing that a run has written
        return False
