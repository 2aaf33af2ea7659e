"""Peak memory of the current process.

On Linux, `ru_maxrss` includes the peak of the parent process. It is therefore useless in a child
of a larger process.
"""

import contextlib
import re
import resource
import sys
from pathlib import Path


def megabytes():
    """Return the peak memory of this process since the last `forget`, or since its start, in MB."""
    if sys.platform == "linux":
        status = Path("/proc/self/status").read_text()
        return int(re.search(r"^VmHWM:\s*(\d+) kB$", status, re.MULTILINE)[1]) / 1e3
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size / (1e6 if sys.platform == "darwin" else 1e3)


def forget():
    """Reset the peak memory, so that an earlier peak does not hide a later one."""
    with contextlib.suppress(OSError):  # if the system does not support it
        Path("/proc/self/clear_refs").write_text("5")
