"""What tests of runs have a process compute."""

import os
import time

from abfm import AbfmError
from abfm.workers.control import CancelledError, checkpoint
from abfm.workers.progress import step
from abfm.workers.worker import report


def count(kept, upto):
    """Report numbers until all are counted, or it is cancelled; return how many."""
    for number in range(upto):
        try:
            checkpoint()
        except CancelledError:
            return number
        report(number)
        time.sleep(0.001)
    return upto


def hold(kept):
    with step("holding"):
        while True:
            time.sleep(0.01)


def pid(kept):
    kept[0] = kept.get(0, 0) + 1
    return os.getpid(), kept[0]


def refuse(kept):
    raise AbfmError("not\nthis")


def pid_if(kept, file):
    """Return the process if there is a file, which it makes, else end."""
    if not file.exists():
        file.touch()
        os._exit(1)
    return os.getpid()
