"""Peak memory of the current process.

On Linux, `ru_maxrss` includes the peak of the parent process. In a child of a larger process it
therefore does not change.
"""

import contextlib
import re
import resource
import sys
from pathlib import Path


def megabytes():
    """Return the peak memory of this process since `forget`, or since its start."""
    if sys.platform == "linux":
        status = Path("/proc/self/status").read_text()
        return int(re.search(r"^VmHWM:\s*(\d+) kB$", status, re.MULTILINE)[1]) / 1e3
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size / (1e6 if sys.platform == "darwin" else 1e3)


def forget():
    """Reset the peak, so that earlier use of memory does not hide later use."""
    with contextlib.suppress(OSError):  # if the system does not support it
        Path("/proc/self/clear_refs").write_text("5")
