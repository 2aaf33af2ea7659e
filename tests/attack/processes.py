"""Commands that are ended at random: by signals, by kills while they save, by a lack of memory.

Linux only: what catches which signal, and which processes are left, is read from /proc.
"""

import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import psutil

import abfm
from abfm import AbfmError, Parameters, load_match, load_mesh, match
from abfm.assets import asset_path
from abfm_viewer.files import outputs
from abfm_viewer.files.project import load_project, save_project
from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.session.session_files import document_of_result
from tests.attack.hunt import FaultError, Trial
from tests.processes import python
from tests.shapes import icosphere

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_MAIN = "import sys; from abfm_viewer.cli import main; sys.exit(main())"
_SAID = ("stopping with the best result so far", "stopping with what was", "abfm: interrupted")
_PROGRESS = ("iteration ", "compiling", "note: ")
_PATIENCE = 60.0  # seconds after which a process does not end


_PAIR = ("--source=gaussian:vertex=10,width=0.2", "--target=gaussian:vertex=40,width=0.2")
_LONG = ("--iterations=1000000", "--tolerance=0", "--sigma=1e-6", "--out=m.npz")
_MOVIE = ("--out=m.mp4", "--size=320x240", "--seconds=0.3", "--quiet")
_BRIEF = ("--iterations=3", "--out=m.npz", "--out=m.vtu", "--quiet")
_BENCH = ("--success", "--only-given", "--problems=1", "--quiet", "--meshes", "MESH")
COMMANDS = {  # words, seconds in which a signal comes, files that may be left
    "match": (("match", "MESH", *_PAIR, *_LONG), 4.0, {"m.npz"}),
    "short match": (("match", "MESH", *_PAIR, *_BRIEF), 3.0, {"m.npz", "m.vtu"}),
    "map": (("map", "RESULT", "--out=map.txt"), 3.0, {"map.txt"}),
    "movie": (("render", "RESULT", *_MOVIE), 4.0, {"m.mp4"}),
    "figure": (("figure", "3", "--quiet", "--out=."), 8.0, {"figure-3.png", "figure-3.json"}),
    "bench": (("bench", *_BENCH), 6.0, set()),
}


class Signals:
    """Sends signals to commands in folders of their own."""

    def __init__(self, folder):
        self._folder = folder
        self._places = {"MESH": str(asset_path("eight.off")), "RESULT": str(folder / "result.npz")}
        mesh = load_mesh(self._places["MESH"])
        x, y, _ = mesh.vertices.T
        match(mesh, x, y, Parameters(iterations=2, levels=1)).save(self._places["RESULT"])

    def attempt(self, chance, name=""):
        """Send one signal, to the process or its group, or two to the process."""
        name = name or chance.choice(list(COMMANDS))
        words, seconds, files = COMMANDS[name]
        number, mode = chance.choice(_SIGNALS), chance.choice(("process", "group", "twice"))
        after, faults = seconds * chance.random(), []
        with tempfile.TemporaryDirectory(dir=self._folder) as place:
            folder = Path(place)
            process = self._start(words, folder)
            _send(process, number, mode, after)
            try:
                _, errors = process.communicate(timeout=_PATIENCE)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                _, errors = process.communicate()
                faults.append(f"no end within {_PATIENCE:g} s")
            if process.returncode not in (0, 3, 128 + number):
                faults.append(f"exit status {process.returncode}")
            lines = [line for line in errors.splitlines() if not line.startswith(_PROGRESS)]
            if process.returncode and (lines := [x for x in lines if not x.startswith(_SAID)]):
                faults.append(f"stderr: {lines[-1][-300:]!r}")
            has_result = "\niteration" in errors and mode != "twice"
            faults += _left(folder, files, needs_result=has_result)
            faults += [f"a process is left: {each}" for each in _lingering(place)]
        _report(f"{name}, {number.name} to {mode} after {after:.2f} s", faults)
        return Trial()

    def _start(self, words, folder):
        temporary = folder / "tmp"
        temporary.mkdir()
        places = {"ABFM_STATE_FOLDER": str(temporary), "TMPDIR": str(temporary)}
        return subprocess.Popen(
            [sys.executable, "-c", _MAIN, *(self._places.get(word, word) for word in words)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            cwd=folder,
            start_new_session=True,
            env=os.environ | places,
            preexec_fn=_take_signals,
        )


def _report(what, faults):
    if faults:
        raise FaultError(f"{what}: {'; '.join(faults)}")


def _take_signals():
    """Undo what a shell in the background ignores."""
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_DFL)


def _send(process, number, mode, after):
    """Send it once the program answers signals; Python's own start is before that."""
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


def _left(folder, files, needs_result):
    """Say what is wrong with the files that a command left."""
    left = {path.name for path in folder.iterdir()} - {"tmp"}
    yield from (f"{name} is left" for name in sorted(left - {*files}))
    kept = {"recent.json", "preferences.json"}
    yield from (
        f"tmp/{path.name} is left" for path in (folder / "tmp").iterdir() if path.name not in kept
    )
    for name in sorted(left & {*files}):
        try:
            load_match(folder / name) if name.endswith(".npz") else None
        except AbfmError as error:
            yield f"{name} does not load: {error}"
        if (folder / name).stat().st_size == 0:
            yield f"{name} is empty"
    if needs_result and "m.npz" not in left:
        yield "the best result is lost"


def _lingering(folder):
    """Return command lines of processes that an ended one has left, after a moment to end in."""
    for _ in range(40):
        found = []
        for process in psutil.process_iter():
            with suppress(psutil.Error):  # it has ended, or is another user's
                if process.environ().get("TMPDIR") == f"{folder}/tmp":
                    found.append(" ".join(process.cmdline())[:100])
        if not found:
            break
        time.sleep(0.05)
    return found


class Kills:
    """Kills children that save one of two versions of a file again and again."""

    def __init__(self, folder):
        mesh = icosphere(2)
        x, y, _ = mesh.vertices.T
        self._matches = [
            abfm.match(mesh, x, y, Parameters(iterations=2 + 2 * k, levels=1)) for k in range(2)
        ]
        self._documents = [document_of_result(each, folder / "m.npz")[0] for each in self._matches]
        self._folder = folder
        self.savings = {  # name of the file: saves a version, reads which one a file is
            "m.npz": (lambda p, v: self._matches[v].save(p), lambda p: len(load_match(p).stages)),
            "m.abfm": (
                lambda p, v: save_project(p, self._documents[v], {}),
                lambda p: len(load_project(p)[0].result.stages),
            ),
            "m.ply": (self._export, lambda p: len(load_mesh(p).vertices) + p.stat().st_size),
            "m.vtu": (self._export, lambda p: (p.stat().st_size, p.read_bytes().rstrip()[-10:])),
            "m.csv": (self._export, lambda p: len(p.read_text().splitlines())),
            "recent.json": (_save_recent, lambda p: len(json.loads(p.read_text()))),
        }

    def _export(self, path, version):
        outputs.write(path, self._matches[version])

    def attempt(self, chance, name=""):
        """Kill a child at a random moment: the old file or the new one is there, complete."""
        name = name or chance.choice(list(self.savings))
        (save, version_of), after = self.savings[name], 0.03 * chance.random()
        with tempfile.TemporaryDirectory(dir=self._folder) as place:
            path, versions, faults = Path(place, name), [], []
            for version in range(2):
                save(path, version)
                versions.append(version_of(path))
            child = os.fork()
            if not child:
                try:
                    while True:
                        for version in range(2):
                            save(path, version)
                finally:
                    os._exit(1)
            time.sleep(after)
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            try:
                if version_of(path) not in versions:
                    faults.append("the file is another one")
            except (AbfmError, ValueError, OSError) as error:
                faults.append(f"the file is broken: {error}"[:200])
            for each in path.parent.iterdir():
                os.utime(each, (0, 0))  # newer ones are kept, as they may be about to be locked
            save(path, 0)
            faults += [f"{left.name} is left" for left in path.parent.iterdir() if left != path]
        _report(f"{name} killed after {after:.3f} s", faults)
        return Trial()


def _save_recent(path, version):
    folder = StateFolder(path.parent)
    folder.add_recent(path) if version else folder.clear_recent()


_CHILD = """
import contextlib, io, resource, sys
from abfm_viewer.cli import main
words = sys.argv[2:]
with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
    main([*words, "--iterations", "1"])  # loads everything
size = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, 2 * (size + int(float(sys.argv[1]) * 2**20),))
sys.exit(main(words))
"""


def lack_memory(chance):
    """Let memory run out in a match: one line, or the best field so far, and no crash.

    Either the limit holds from the start, where libraries are loaded, or for a match alone.
    """
    mesh, megabytes = (
        asset_path(chance.choice(("eight.off", "human_A.off"))),
        chance.randint(1, 900),
    )
    from_start = chance.random() < 0.3
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "m.npz")
        words = ["match", mesh, *_PAIR, "--iterations=15", "--out", out, "--quiet"]
        limits = {"env": os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}}
        if from_start:
            size = (250 + megabytes) << 20
            limits["preexec_fn"] = lambda: resource.setrlimit(resource.RLIMIT_AS, (size, size))
        child = python(
            _MAIN if from_start else _CHILD, *([] if from_start else [megabytes]), *words, **limits
        )
        faults = [f"{path.name} is left" for path in Path(folder).iterdir() if path != out]
        lines = child.stderr.strip().splitlines()
        if child.returncode not in (0, 2, 3) or "Traceback" in child.stderr:
            faults.append(f"exit status {child.returncode}: {(lines or [''])[-1][:200]}")
        if child.returncode == 2 and not lines:
            faults.append("no reason")
        if child.returncode in (0, 3):
            load_match(out)
    _report(f"{mesh.name} with {megabytes} MB{' from the start' * from_start}", faults)
    return Trial(child.returncode == 2)
