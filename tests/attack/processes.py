"""Commands that are ended at random, by signals, kills or a lack of memory, and batches.

Linux only: handled signals and remaining processes are read from /proc.
"""

import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import psutil

import abfm
from abfm import AbfmError, Parameters, load
from abfm.assets import asset_path
from abfm_viewer.files import outputs
from abfm_viewer.files.documents import document_of_result
from abfm_viewer.files.project import load_project, save_project
from abfm_viewer.files.state_folder import StateFolder
from tests.attack.specimens import specimens
from tests.attack.trial import FaultError, Trial
from tests.mesh_writers import write
from tests.processes import family, kill, lingering, python
from tests.shapes import icosphere
from tests.viewer.cli.batches import (
    MAIN,
    changed_results,
    results,
    start,
    victims,
    write_table,
    written,
)

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_STOPPED = ("stopping with the best", "stopping with the finished", "abfm: interrupted")
_PHASES = ("match", "refine", "check", "initial map")
_PROGRESS = (*_PHASES, "compiling", "note: ")
_END_SECONDS_MAX = 60.0  # a process that runs longer counts as endless
_ROWS, _KILLS, _SECONDS_MAX = 12, 3, 4.0  # of a batch

_PAIR = ("--source=gaussian:vertex=10,width=0.2", "--target=gaussian:vertex=40,width=0.2")
_LONG = ("--set=iterations=1000000", "--set=tolerance=0", "--sigma=1e-6", "--out=m.npz")
_MOVIE = ("--out=m.mp4", "--size=320x240", "--seconds=0.3", "--quiet")
_BRIEF = ("--set=iterations=3", "--out=m.npz", "--out=m.vtu", "--quiet")
COMMANDS = {  # arguments, seconds within which a signal is sent, files that may remain
    "match": (("match", "MESH", *_PAIR, *_LONG), 4.0, {"m.npz"}),
    "short match": (("match", "MESH", *_PAIR, *_BRIEF), 3.0, {"m.npz", "m.vtu"}),
    "map": (("map", "RESULT", "--out=map.txt"), 3.0, {"map.txt"}),
    "movie": (("render", "RESULT", *_MOVIE), 4.0, {"m.mp4"}),
    "figure": (("figure", "3", "--quiet", "--out=."), 8.0, {"figure-3.png", "figure-3.json"}),
}


class Signals:
    """Sends signals to commands in their own folders."""

    def __init__(self, folder):
        self._folder = folder
        self._places = {"MESH": str(asset_path("eight.off")), "RESULT": str(folder / "result.npz")}
        write(folder, "result.npz", specimens()["result.npz"].content)

    def attempt(self, chance, name=""):
        """Send one signal to a process or its group, or two signals to the process."""
        name = name or chance.choice(list(COMMANDS))
        words, seconds, files = COMMANDS[name]
        number, mode = chance.choice(_SIGNALS), chance.choice(("process", "group", "twice"))
        after, faults = seconds * chance.random(), []
        with tempfile.TemporaryDirectory(dir=self._folder) as place:
            folder = Path(place)
            (folder / "tmp").mkdir()
            places = dict.fromkeys(("ABFM_STATE_FOLDER", "TMPDIR"), str(folder / "tmp"))
            process = subprocess.Popen(
                [sys.executable, "-c", MAIN, *(self._places.get(word, word) for word in words)],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                cwd=folder,
                start_new_session=True,
                env=os.environ | places,
                preexec_fn=_restore_signals,
            )
            _send(process, number, mode, after)
            try:
                _, errors = process.communicate(timeout=_END_SECONDS_MAX)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                _, errors = process.communicate()
                faults.append(f"no end within {_END_SECONDS_MAX:g} s")
            if process.returncode not in (0, 3, 128 + number):
                faults.append(f"exit status {process.returncode}")
            lines = [line for line in errors.splitlines() if not line.startswith(_PROGRESS)]
            if process.returncode and (lines := [x for x in lines if not x.startswith(_STOPPED)]):
                faults.append(f"stderr: {lines[-1][-300:]!r}")
            has_result = "\nrefine" in errors and mode != "twice"
            faults += _faults_of_files(folder, files, needs_result=has_result)
            remaining = lingering(_processes_of_folder(place), 2)
            faults += [f"process {each} remains" for each in remaining]
        return _trial(f"{name}, {number.name} to {mode} after {after:.2f} s", faults)


def _trial(what, faults, is_refused=False):
    if faults:
        raise FaultError(f"{what}: {'; '.join(faults)}")
    return Trial(is_refused)


def _restore_signals():
    """Undo the signals that a shell in the background ignores."""
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_DFL)


def _send(process, number, mode, after):
    """Send a signal to a process once it handles signals, which it does not while Python starts."""
    while process.poll() is None:
        status = Path(f"/proc/{process.pid}/status").read_text().splitlines()
        caught = next((line.split()[1] for line in status if line.startswith("SigCgt:")), "0")
        if int(caught, 16) >> (signal.SIGHUP - 1) & 1:
            break
        time.sleep(0.001)
    with suppress(subprocess.TimeoutExpired):
        process.wait(after)
        return
    (os.killpg if mode == "group" else os.kill)(process.pid, number)
    if mode == "twice" and process.poll() is None:
        process.send_signal(number)


def _faults_of_files(folder, files, needs_result):
    """Return the faults of the files that a command left behind."""
    left = {path.name for path in folder.rglob("*")} - {"tmp", "recent.json", "preferences.json"}
    yield from (f"{name} is left" for name in sorted(left - files))
    for name in sorted(left & files):
        try:
            if name.endswith(".npz"):
                load(folder / name)
        except AbfmError as error:
            yield f"{name} does not load: {error}"
        if (folder / name).stat().st_size == 0:
            yield f"{name} is empty"
    if needs_result and "m.npz" not in left:
        yield "the best result is lost"


def _processes_of_folder(folder):
    """Return the ids of processes whose temporary files are in a folder."""
    found = []
    for process in psutil.process_iter():
        with suppress(psutil.Error):  # it has ended, or belongs to another user
            if process.environ().get("TMPDIR") == f"{folder}/tmp":
                found.append(process.pid)
    return found


class Kills:
    """Kills children that repeatedly save one of two versions of a file."""

    def __init__(self, folder):
        mesh = icosphere(2)
        x, y, _ = mesh.vertices.T
        self._matches = [
            abfm.match(mesh, x, y, Parameters.of(iterations=2 + 2 * k, levels=1)) for k in range(2)
        ]
        self._documents = [document_of_result(each, folder / "m.npz")[0] for each in self._matches]
        self._folder = folder
        self.savings = {  # by name: functions that save and read a version
            "m.npz": (lambda p, v: self._matches[v].save(p), lambda p: len(load(p).stages)),
            "m.abfm": (
                lambda p, v: save_project(p, self._documents[v], {}),
                lambda p: len(load_project(p)[0].result.stages),
            ),
            "m.vtu": (
                lambda p, v: outputs.write(p, self._matches[v]),
                lambda p: (p.stat().st_size, p.read_bytes().rstrip()[-10:]),
            ),
            "recent.json": (
                lambda p, v: StateFolder(p.parent).add_recent(p.parent / str(v)),
                lambda p: len(StateFolder(p.parent).recent()),  # 0 if it is broken
            ),
        }

    def attempt(self, chance, name=""):
        """Kill a child at a random moment; the complete old or new file must exist afterwards."""
        name = name or chance.choice(list(self.savings))
        (save, version_of), after = self.savings[name], 0.03 * chance.random()
        with tempfile.TemporaryDirectory(dir=self._folder) as place:
            path, versions, faults = Path(place, name), [], []
            for version in range(2):
                save(path, version)
                versions.append(version_of(path))
            child = get_context("fork").Process(target=_save_repeatedly, args=(save, path))
            child.start()
            time.sleep(after)
            child.kill()
            child.join()
            try:
                if version_of(path) not in versions:
                    faults.append("the file is another one")
            except (AbfmError, ValueError, OSError) as error:
                faults.append(f"the file is broken: {error}"[:200])
            for each in path.parent.iterdir():
                os.utime(each, (0, 0))  # newer ones stay, as they may be about to be locked
            save(path, 0)
            faults += [f"{left.name} is left" for left in path.parent.iterdir() if left != path]
        return _trial(f"{name} killed after {after:.3f} s", faults)


def _save_repeatedly(save, path):
    while True:
        for version in range(2):
            save(path, version)


def lack_memory(chance):
    """Let memory run out in a match: one line or the best field so far, and no crash."""
    mesh = asset_path(chance.choice(("eight.off", "human_A.off")))
    megabytes = chance.randint(250, 1400)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "m.npz")
        words = ["match", mesh, *_PAIR, "--set=iterations=15", "--out", out, "--quiet"]
        limit = partial(resource.setrlimit, resource.RLIMIT_AS, 2 * (megabytes << 20,))
        child = python(MAIN, *words, preexec_fn=limit)
        faults = [f"{path.name} is left" for path in Path(folder).iterdir() if path != out]
        lines = child.stderr.strip().splitlines()
        if child.returncode not in (0, 2, 3) or "Traceback" in child.stderr:
            faults.append(f"exit status {child.returncode}: {(lines or [''])[-1][:200]}")
        if child.returncode == 2 and not lines:
            faults.append("no reason")
        if child.returncode in (0, 3):
            load(out)
    return _trial(f"{mesh.name} with {megabytes} MB", faults, child.returncode == 2)


class Batches:
    """Kills the client and workers of a batch that was solved undisturbed once.

    The batch resumes, solves no finished row again, and ends with the same files, bit for bit.
    """

    def __init__(self, folder):
        self._folder, self._table = folder, folder / "table.csv"
        write_table(self._table, _ROWS, iterations=60)
        start(self._table, folder / "alone", "--quiet", "--jobs=1").communicate()
        self._expected = results(folder / "alone")

    def attempt(self, chance):
        """Kill processes of a batch by two workers until it ends by itself."""
        with tempfile.TemporaryDirectory(dir=self._folder) as place:
            out, process = Path(place, "out"), None
            killed, done, there = [], {}, set()
            while process is None or process.returncode == -signal.SIGKILL:
                process = start(self._table, out, "--jobs=2")
                seconds = _SECONDS_MAX * chance.random() if len(killed) < _KILLS else 300
                with suppress(subprocess.TimeoutExpired):
                    process.communicate(timeout=seconds)
                if process.poll() is None:
                    found = victims(process.pid)
                    there |= {*family(process.pid)}
                    done = written(out) | done
                    who = chance.choice([each for each in found if found[each]])
                    kill(chance.choice(found[who]))
                    killed.append(who)
                    if who != "client":
                        kill(process.pid)
                    process.communicate()
            faults = [
                f"{name[:8]} was solved again" for name in changed_results(done, written(out))
            ]
            faults += [] if results(out) == self._expected else ["other results than undisturbed"]
            faults += [f"process {each} remains" for each in lingering(there)]
        if process.returncode not in (0, 3):
            faults.append(f"exit status {process.returncode}")
        return _trial(f"batch, killed {', '.join(killed)}", faults)
