"""A process that opens hostile files, with limited memory and time, and its watcher."""

import contextlib
import faulthandler
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from multiprocessing import get_context
from pathlib import Path

from abfm import AbfmError
from tests import peak_memory
from tests.attack import readers
from tests.attack.trial import FaultError, Trial
from tests.processes import ROOT

# limits of CPU time and of memory growth for a file of at most this size
SECONDS, MEGABYTES, LARGEST = 10, 1000, 10 << 20
_ADDRESS_SPACE, _HERE = 3 << 30, f"{ROOT}{os.sep}"
_WAIT_SECONDS_MAX = 120.0  # wall-clock seconds, for a process that waits without computing


class Victim(contextlib.ExitStack):
    """Opens files in a process, which is restarted when it dies. Files with a fault are stored."""

    def __init__(self, keep, seconds=SECONDS, megabytes=MEGABYTES, open_file=readers.read_as):
        super().__init__()
        self._keep, self._limits, self._open_file = keep, (seconds, megabytes), open_file
        self._process = None
        place = self.enter_context(tempfile.TemporaryDirectory(prefix="abfm-attack-"))
        self._folder = Path(place)
        self.callback(self._end)

    def open(self, specimen, kind):
        """Return the trial of a specimen, or raise a `FaultError` and store its files."""
        files = self._folder / "files"
        put(specimen, files)
        answer = self._request(specimen.reader, files / specimen.name)
        fault = answer.pop("fault")
        if fault:
            put(specimen, self._keep / specimen.name)
            raise FaultError(f"{specimen.name} {kind}: {fault.replace(f'{files}{os.sep}', '')}")
        return Trial(**answer)

    def _request(self, reader, path):
        if self._process is None:
            context = get_context("forkserver")  # its processes start with the imported modules
            context.set_forkserver_preload(["tests.attack.readers"])
            self._connection, other = context.Pipe()
            words = other, self._folder / "log", self._open_file, *self._limits
            self._process = context.Process(target=_answer_all, args=words)
            self._process.start()
            other.close()
        self._connection.send((reader, path))
        has_answered = self._connection.poll(_WAIT_SECONDS_MAX)
        try:
            answer = self._connection.recv() if has_answered else None
        except (EOFError, ConnectionError):
            answer = None
        if answer is None:
            answer = {"fault": self._death(has_answered)}
            self._end()
        elif answer["fault"] and answer["megabytes"] > self._limits[1]:
            self._end()  # so that the memory of the next file can be measured
        return answer

    def _death(self, has_ended):
        why = f"no answer within {_WAIT_SECONDS_MAX:g} s by the clock"
        if has_ended:
            self._process.join()
            status = self._process.exitcode
            name = signal.Signals(-status).name if status < 0 else f"exit status {status}"
            why = f"the process died: {name}"
            if status == -signal.SIGPROF:
                why = f"more than {self._limits[0]} s of CPU time"
        log = (self._folder / "log").read_text(errors="replace").strip().splitlines()
        own = [each for each in log if "/core/abfm/" in each or "/abfm_viewer/" in each]
        place = (own[:1] or log[-1:] or ["no stack"])[0].strip()
        return f"{why}: {place.replace(_HERE, '')[:300]}"

    def _end(self):
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._connection.close()
            self._process = None


def put(specimen, folder):
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name, content in {**specimen.companions, specimen.name: specimen.content}.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def _answer_all(connection, log, open_file, seconds, megabytes):
    """Open the files that are sent through a connection, and send an answer for each."""
    os.chdir(log.parent)
    with log.open("w") as stacks, tempfile.TemporaryFile("w+") as printed:
        os.dup2(printed.fileno(), 1)
        os.dup2(printed.fileno(), 2)
        faulthandler.enable(stacks)
        faulthandler.register(signal.SIGPROF, stacks, chain=True)
        resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
        with contextlib.suppress(EOFError):
            while True:
                answer = _answer(open_file, *connection.recv(), seconds, megabytes)
                sys.stdout.flush()
                sys.stderr.flush()
                printed.seek(0)
                if (text := printed.read()) and not answer["fault"]:
                    answer["fault"] = f"output: {text[:300]!r}"
                printed.seek(0)
                printed.truncate()
                connection.send(answer)


def _answer(open_file, reader, path, seconds_max, megabytes_max):
    peak_memory.forget()
    memory, begin = peak_memory.megabytes(), time.process_time()
    is_refused, fault = False, ""
    signal.setitimer(signal.ITIMER_PROF, seconds_max)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            open_file(reader, path)
    except AbfmError:
        is_refused = True
    except FaultError as error:
        fault = str(error)
    except Exception as error:
        fault = _described(error)
    signal.setitimer(signal.ITIMER_PROF, 0)
    seconds, grown = time.process_time() - begin, peak_memory.megabytes() - memory
    if grown > megabytes_max:
        fault = fault or f"{grown:.0f} MB of memory"
    measured = {"seconds": round(seconds, 3), "megabytes": round(grown, 1)}
    return {"fault": fault, "is_refused": is_refused, **measured}


def _described(error):
    """Return the text of an exception, and where it left abfm, or the failed assertion."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename.startswith(_HERE)]
    own = [f for f in frames if "/tests/" not in f.filename]
    own = [f"{f.filename.removeprefix(_HERE)}:{f.lineno}" for f in own] or ["outside of abfm"]
    text = str(error) or frames[-1].line
    return f"{type(error).__name__}: {' '.join(text.split())[:300]} ({own[-1]})"
