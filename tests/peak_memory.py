"""The most memory that a process has had.

`ru_maxrss` tells on Linux also what another process had of which this one was made: in a child of a
process that is larger it stays as it is.
"""

import contextlib
import re
import resource
import sys
from pathlib import Path


def megabytes():
    """The most that this process has had since `forget`, or ever where nothing is forgotten."""
    if sys.platform == "linux":
        status = Path("/proc/self/status").read_text()
        return int(re.search(r"^VmHWM:\s*(\d+) kB$", status, re.MULTILINE)[1]) / 1e3
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size / (1e6 if sys.platform == "darwin" else 1e3)


def forget():
    """Count from now on: what was needed before does not hide what is needed next."""
    with contextlib.suppress(OSError):  # where the system has no such thing
        Path("/proc/self/clear_refs").write_text("5")
