"""A process that opens one attacking file after the other, and what came of each; and who watches
over it.

The process has bounded memory and, for each file, bounded time; it is started again when it dies.
"""

import contextlib
import faulthandler
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
from importlib import import_module
from pathlib import Path

from abfm import AbfmError
from tests import peak_memory
from tests.attack.doors import BrokenPromiseError, enter
from tests.attack.trial import Trial, run
from tests.processes import ROOT

# the most CPU time that a file may take, and memory by which the process may grow, up to a size
SECONDS, MEGABYTES, LARGEST = 10, 1000, 10 << 20
_ADDRESS_SPACE = 3 << 30
_PATIENCE = 120.0  # seconds by the clock, for what waits without computing


def run_victim(part, attacker, about):
    """The main program of a part that attacks with the file that its function makes of a seed."""
    with Victim(part, f"tests.attack.{part}:{attacker}", ROOT / "out" / "attack") as victim:
        run(victim.attempt, about)


class Victim:
    """Tries the files of an attacker, ``module:function``; those that make a fault are kept."""

    def __init__(self, part, attacker, keep, seconds=SECONDS, megabytes=MEGABYTES):
        self._part, self._attacker, self._keep = part, attacker, keep
        self._seconds, self._megabytes = seconds, megabytes
        self._process = None
        self._folder = Path(tempfile.mkdtemp(prefix="abfm-attack-"))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._end()
        shutil.rmtree(self._folder, ignore_errors=True)

    def attempt(self, seed):
        """What comes of the file of a seed."""
        if self._process is None or self._process.poll() is not None:
            self._start()
        process = self._process
        process.stdin.write(f"{seed}\n")
        process.stdin.flush()
        ready, _, _ = select.select([process.stdout], [], [], _PATIENCE)
        line = process.stdout.readline() if ready else ""
        trial = Trial.from_line(line) if line else self._died(seed, bool(ready))
        if trial.outcome == "fault":
            place = self._keep / f"{self._part}-{seed}"
            shutil.rmtree(place, ignore_errors=True)
            shutil.copytree(self._folder / "files", place, symlinks=True, ignore=_what_is_no_file)
            if trial.megabytes > self._megabytes:  # so that the next one's memory can be told
                self._end()
        return trial

    def _start(self):
        words = [self._attacker, self._folder, self._seconds, self._megabytes]
        with (self._folder / "log").open("w") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.attack.victim", *map(str, words)],
                cwd=ROOT,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
            )

    def _died(self, seed, has_ended):
        why = f"nothing within {_PATIENCE:g} s by the clock"
        if has_ended:
            status = self._process.wait()
            name = signal.Signals(-status).name if status < 0 else f"exit status {status}"
            why = f"the process died: {name}"
            if status == -signal.SIGPROF:
                why = f"more than {self._seconds} s of CPU time"
        self._end()
        log = (self._folder / "log").read_text(errors="replace")
        if not (self._folder / "kind").exists():
            raise RuntimeError(f"the process that is attacked did not begin: {log}")
        return Trial((self._folder / "kind").read_text(), seed, "fault", f"{why}: {_place(log)}")

    def _end(self):
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


def _what_is_no_file(folder, names):
    paths = {name: Path(folder, name) for name in names}
    return [n for n, path in paths.items() if not path.is_file() or path.stat().st_size > 64 << 20]


def _place(log):
    """Where a stack that faulthandler wrote was in our own code, or the end of what was said."""
    frames = [line.strip() for line in log.splitlines() if "File " in line]
    own = [f for f in frames if "/core/abfm/" in f or "/abfm_viewer/" in f]
    lines = own[:1] or log.strip().splitlines()[-1:] or ["no stack"]
    return lines[0].replace(str(ROOT) + os.sep, "")[:300]


def main(attacker, folder, seconds, megabytes):
    """The process: reads seeds, a line each, and answers a line of a `Trial` each."""
    module, _, name = attacker.partition(":")
    files_of = getattr(import_module(module), name)
    stacks = os.fdopen(os.dup(2), "w")  # stays where it is while what is said is listened to
    faulthandler.enable(stacks)
    faulthandler.register(signal.SIGPROF, stacks, chain=True)
    answers = os.fdopen(os.dup(1), "w")
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
    for line in sys.stdin:
        trial = _attempt(files_of, int(line), folder, seconds, megabytes)
        print(trial.to_line(), file=answers, flush=True)


def _attempt(files_of, seed, folder, most_seconds, most_megabytes):
    (folder / "kind").write_text("the attack itself")
    files = folder / "files"
    shutil.rmtree(files, ignore_errors=True)
    files.mkdir()
    specimen, kind = files_of(seed)
    (folder / "kind").write_text(kind)
    path = files / specimen.name
    for name, content in {specimen.name: specimen.content, **specimen.beside}.items():
        (files / name).write_bytes(content)
    if specimen.place is not None:
        specimen.place(path)
    size = path.stat().st_size if path.is_file() else 0
    peak_memory.forget()
    memory, begin = peak_memory.megabytes(), time.process_time()
    said, outcome, detail = [], "ok", ""
    signal.setitimer(signal.ITIMER_PROF, most_seconds)
    try:
        with _listening(said):
            enter(specimen.door, path)
    except AbfmError as error:
        outcome, detail = "refused", str(error)
    except BrokenPromiseError as error:
        outcome, detail = "fault", str(error)
    except Exception as error:
        outcome, detail = "fault", _last_of_ours(error)
    signal.setitimer(signal.ITIMER_PROF, 0)
    seconds, grown = time.process_time() - begin, peak_memory.megabytes() - memory
    if outcome != "fault" and said:
        outcome, detail = "fault", f"it said: {said[0][:300]!r}"
    if outcome != "fault" and grown > most_megabytes and size <= LARGEST:
        outcome, detail = "fault", f"{grown:.0f} MB of memory; then: {detail}"
    if size > LARGEST:  # may take longer and more
        seconds = grown = 0.0
    detail = detail.replace(str(files) + os.sep, "")
    return Trial(kind, seed, outcome, detail, round(seconds, 3), round(grown, 1))


def _last_of_ours(error):
    """An exception that should not have come out: its text, and where it left our own code."""
    own = [
        f"{Path(frame.filename).relative_to(ROOT)}:{frame.lineno}"
        for frame in traceback.extract_tb(error.__traceback__)
        if Path(frame.filename).is_relative_to(ROOT) and "/tests/" not in frame.filename
    ]
    text = " ".join(str(error).split())[:160]
    return f"{type(error).__name__}: {text} ({own[-1] if own else 'outside of abfm'})"


@contextlib.contextmanager
def _listening(said):
    """Take down what is written to stdout and stderr, by C libraries too, and warnings."""
    with tempfile.TemporaryFile("w+") as heard, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with _redirected(1, heard), _redirected(2, heard):
            try:
                yield
            finally:
                heard.flush()
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
    main(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
