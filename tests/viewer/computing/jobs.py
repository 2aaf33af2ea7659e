"""Functions that tests of runs call in a process."""

import os
import time

from abfm import AbfmError
from abfm.workers.control import CancelledError, checkpoint
from abfm.workers.progress import step
from abfm.workers.worker import report


def count(cache, upto):
    """Report the numbers up to a limit, or until the run is cancelled; return their count."""
    for number in range(upto):
        try:
            checkpoint()
        except CancelledError:
            return number
        report(number)
        time.sleep(0.001)
    return upto


def hold(cache):
    with step("holding"):
        while True:
            time.sleep(0.01)


def pid(cache):
    cache[0] = cache.get(0, 0) + 1
    return os.getpid(), cache[0]


def refuse(cache):
    raise AbfmError("not\nthis")


def pid_if(cache, file):
    """Return the process id if a file exists; otherwise create the file and kill this process."""
    if not file.exists():
        file.touch()
        os._exit(1)
    return os.getpid()
