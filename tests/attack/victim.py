"""A process that opens attacking files, with bounded memory and time, and its watcher."""

import contextlib
import faulthandler
import json
import os
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path

from abfm import AbfmError
from tests import peak_memory
from tests.attack.hunt import FaultError, Trial
from tests.processes import ROOT

# CPU time that a file of at most so many bytes may take, and memory by which the process may grow
SECONDS, MEGABYTES, LARGEST = 10, 1000, 10 << 20
_ADDRESS_SPACE = 3 << 30
_PATIENCE = 120.0  # seconds by the clock, for what waits without computing


class Victim:
    """Opens files in a process that is started again when it dies; those with a fault are kept."""

    def __init__(self, keep, seconds=SECONDS, megabytes=MEGABYTES, door="tests.attack.doors"):
        self._keep, self._limits, self._doors = keep, (seconds, megabytes), door
        self._process = None
        self._folder = Path(tempfile.mkdtemp(prefix="abfm-attack-"))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._end()
        shutil.rmtree(self._folder, ignore_errors=True)

    def open(self, specimen, kind):
        """Return the trial of a specimen, or raise a `FaultError` and keep its files."""
        files = self._folder / "files"
        shutil.rmtree(files, ignore_errors=True)
        files.mkdir()
        for name, content in {**specimen.beside, specimen.name: specimen.content}.items():
            (files / name).parent.mkdir(parents=True, exist_ok=True)
            (files / name).write_bytes(content)
        if specimen.place is not None:
            specimen.place(files / specimen.name)
        answer = self._ask(specimen.door, files / specimen.name)
        fault = answer.pop("fault")
        if not fault and specimen.must_be_refused and not answer["is_refused"]:
            fault = "it was opened, and should be refused"
        if fault:
            place = self._keep / specimen.name
            shutil.rmtree(place, ignore_errors=True)
            shutil.copytree(files, place, symlinks=True, ignore=_special_files)
            raise FaultError(f"{specimen.name} {kind}: {fault.replace(f'{files}{os.sep}', '')}")
        return Trial(**answer)

    def _ask(self, door, path):
        if self._process is None or self._process.poll() is not None:
            self._end()
            self._start()
        process = self._process
        process.stdin.write(json.dumps([door, str(path)]) + "\n")
        process.stdin.flush()
        ready, _, _ = select.select([process.stdout], [], [], _PATIENCE)
        line = process.stdout.readline() if ready else ""
        answer = json.loads(line) if line else {"fault": self._death(bool(ready))}
        if answer["fault"] and answer.get("megabytes", 0) > self._limits[1]:
            self._end()  # so that the memory of the next one can be measured
        return answer

    def _start(self):
        with (self._folder / "log").open("w") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.attack.victim", self._doors, *map(str, self._limits)],
                cwd=ROOT,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
            )

    def _death(self, has_ended):
        why = f"no answer within {_PATIENCE:g} s by the clock"
        if has_ended:
            status = self._process.wait()
            name = signal.Signals(-status).name if status < 0 else f"exit status {status}"
            why = f"the process died: {name}"
            if status == -signal.SIGPROF:
                why = f"more than {self._limits[0]} s of CPU time"
        log = (self._folder / "log").read_text(errors="replace")
        frames = [line.strip() for line in log.splitlines() if "File " in line]
        own = [line for line in frames if "/core/abfm/" in line or "/abfm_viewer/" in line]
        place = (own[:1] or log.strip().splitlines()[-1:] or ["no stack"])[0]
        return f"{why}: {place.replace(f'{ROOT}{os.sep}', '')[:300]}"

    def _end(self):
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


def _special_files(folder, names):
    return [n for n in names if os.path.islink(f"{folder}/{n}") or not _is_plain(f"{folder}/{n}")]


def _is_plain(path):
    return os.path.isfile(path) or os.path.isdir(path)


def main(doors, seconds, megabytes):
    """Read doors and paths, a line each, and answer each in a line."""
    module = __import__(doors, fromlist=["enter"])
    stacks = os.fdopen(os.dup(2), "w")  # stays where it is while output is captured
    faulthandler.enable(stacks)
    faulthandler.register(signal.SIGPROF, stacks, chain=True)
    answers = os.fdopen(os.dup(1), "w")
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
    for line in sys.stdin:
        door, name = json.loads(line)
        answer = _answer(module.enter, door, Path(name), seconds, megabytes)
        print(json.dumps(answer), file=answers, flush=True)


def _answer(enter, door, path, seconds_max, megabytes_max):
    size = path.stat().st_size if path.is_file() else 0
    peak_memory.forget()
    memory, begin = peak_memory.megabytes(), time.process_time()
    said, is_refused, fault = [], False, ""
    signal.setitimer(signal.ITIMER_PROF, seconds_max)
    try:
        with _captured(said):
            enter(door, path)
    except AbfmError:
        is_refused = True
    except FaultError as error:
        fault = str(error)
    except Exception as error:
        fault = _last_of_ours(error)
    signal.setitimer(signal.ITIMER_PROF, 0)
    seconds, grown = time.process_time() - begin, peak_memory.megabytes() - memory
    if said:
        fault = fault or f"output: {said[0][:300]!r}"
    if grown > megabytes_max and size <= LARGEST:
        fault = fault or f"{grown:.0f} MB of memory"
    if size > LARGEST:  # may take longer and more
        seconds = grown = 0.0
    measured = {"seconds": round(seconds, 3), "megabytes": round(grown, 1)}
    return {"fault": fault, "is_refused": is_refused, **measured}


def _last_of_ours(error):
    """Return the text of an exception, and the line of our code that it left."""
    own = [
        f"{Path(frame.filename).relative_to(ROOT)}:{frame.lineno}"
        for frame in traceback.extract_tb(error.__traceback__)
        if Path(frame.filename).is_relative_to(ROOT) and "/tests/" not in frame.filename
    ]
    text = " ".join(str(error).split())[:160]
    return f"{type(error).__name__}: {text} ({own[-1] if own else 'outside of abfm'})"


@contextlib.contextmanager
def _captured(said):
    """Note output to stdout and stderr, also of C libraries, and warnings."""
    with tempfile.TemporaryFile("w+") as heard, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with _redirected(1, heard), _redirected(2, heard):
            yield
        heard.seek(0)
        said += filter(None, [heard.read()])
        said += [f"{w.category.__name__}: {w.message}" for w in caught]


@contextlib.contextmanager
def _redirected(descriptor, heard):
    saved = os.dup(descriptor)
    os.dup2(heard.fileno(), descriptor)
    try:
        yield
    finally:
        (sys.stdout if descriptor == 1 else sys.stderr).flush()
        os.dup2(saved, descriptor)
        os.close(saved)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
