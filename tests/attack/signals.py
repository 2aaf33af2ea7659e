"""Signals at random moments of every command: one line, the status that shells know, whole files,
nothing left behind.

A command first runs undisturbed, which says how long it lives; a signal comes between the moment
when the program has taken its signals over (Python's own start is before that) and a little after
that life. Linux only: what catches which signal, and which processes are left, is read from /proc.
"""

import os
import random
import secrets
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from abfm import AbfmError, Parameters, load_match, load_mesh, match
from abfm.assets import asset_path
from tests.attack.trial import Trial, run

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# to the process alone, as a terminal does it, and a second one soon after
MODES = ("process", "group", "twice")
STOPPING = "stopping with the best result so far; Ctrl-C again to leave at once"
REPORTED = "stopping with what was finished; Ctrl-C again to leave at once"
_MAIN = "import sys; from abfm_viewer.{} import main; sys.exit(main())"
_PATIENCE = 60.0  # seconds after which a process does not end


@dataclass(frozen=True)
class Command:
    """The words of a command line, the files that it may leave, and how long it may run if
    nobody ends it.
    """

    words: list[str]
    files: tuple[str, ...] = ()
    statuses: tuple[int, ...] = (0,)  # of a run that ends by itself
    module: str = "cli"
    lasts: float = 0.0  # seconds after the start; 0: to its end


PAIR = ["--source=gaussian:vertex=10,width=0.2", "--target=gaussian:vertex=40,width=0.2", "--quiet"]
MOVIE = ["--size=320x240", "--seconds=0.3", "--quiet"]
LONG = ["--iterations=1000000", "--tolerance=0", "--sigma=1e-6"]
ENDLESS = ["match", "MESH", *PAIR, *LONG, "--out=m.npz"]
BRIEF = ["match", "MESH", *PAIR, "--iterations=3", "--out=m.npz", "--out=m.vtu"]
BENCH = ["bench", "--success", "--only-given", "--meshes", "MESH"]
DEMO, FIGURE = ("demo.npz", "demo.png", "demo.mp4"), ("figure-3.png", "figure-3.json")
COMMANDS = {
    "help": Command(["match", "--help"]),
    "info": Command(["info", "MESH"]),
    "match": Command(ENDLESS, ("m.npz",), (3,), lasts=4.0),
    "short match": Command(BRIEF, ("m.npz", "m.vtu"), (3,)),
    "map": Command(["map", "RESULT", "--out=map.txt"], ("map.txt",)),
    "picture": Command(["render", "RESULT", "--out=m.png", "--size=320x240"], ("m.png",)),
    "mp4": Command(["render", "RESULT", "--out=m.mp4", *MOVIE], ("m.mp4",)),
    "gif": Command(["render", "RESULT", "--out=m.gif", *MOVIE], ("m.gif",)),
    "demo": Command(["demo", "--quiet", "--out=."], DEMO, lasts=12.0),
    "figure": Command(["figure", "3", "--mesh", "MESH", "--quiet", "--out=."], FIGURE, lasts=8.0),
    "bench": Command([*BENCH, "--problems=1", "--quiet", "--json"]),
    "window": Command(["MESH"], statuses=(2,), module="app", lasts=6.0 * ("DISPLAY" in os.environ)),
}


class Attack:
    """Sends signals to commands in folders of their own; unknown `lives` are measured first."""

    def __init__(self, folder, lives=()):
        self._folder, self._lives = folder, dict(lives)
        self._places = {"MESH": str(asset_path("eight.off")), "RESULT": str(folder / "result.npz")}
        mesh = load_mesh(self._places["MESH"])
        x, y, _ = mesh.vertices.T
        match(mesh, x, y, Parameters(iterations=2, levels=1)).save(self._places["RESULT"])

    def attempt(self, seed):
        """The trial of a seed."""
        chance = random.Random(seed)
        name = chance.choice(list(COMMANDS))
        told, faults = self.one(name, chance)
        return Trial(f"{name}, {told}", seed, "fault" if faults else "ok", "; ".join(faults))

    def one(self, name, chance):
        """Send one signal to a command: what came when, and what was wrong with what came of it."""
        command = COMMANDS[name]
        if name not in self._lives:
            self._lives[name] = command.lasts or self._life(command)
        number, mode = chance.choice(SIGNALS), chance.choice(MODES)
        after, faults = 1.02 * self._lives[name] * chance.random(), []
        with tempfile.TemporaryDirectory(dir=self._folder) as place:
            folder = Path(place)
            process, token = self._start(command, folder)
            pause = chance.choice([0.0, 0.01, 0.3])
            was_there = _send(process, number, mode, after, pause)
            try:
                _, errors = process.communicate(timeout=_PATIENCE)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                _, errors = process.communicate()
                faults.append(f"it did not end within {_PATIENCE:g} s")
            status, lines = process.returncode, errors.splitlines()
            ended_by_itself = status in command.statuses
            if not (ended_by_itself or (was_there and status == 128 + number)):
                faults.append(f"status {status}")
            program = "abfm-viewer" if command.module == "app" else "abfm"
            unexpected = set(lines) - {f"{program}: interrupted", STOPPING, REPORTED}
            if not ended_by_itself and ((not lines and mode != "twice") or unexpected):
                faults.append(f"stderr: {errors[-300:]!r}")
            faults += _left(folder, command.files, STOPPING in errors and mode != "twice")
            faults += [f"a process is left: {words}" for words in _processes(token)]
        return f"{number.name} {mode} after {after:.3f} s", faults

    def _start(self, command, folder):
        token, temporary = secrets.token_hex(8), folder / "tmp"
        temporary.mkdir(exist_ok=True)
        words = (self._places.get(word, word) for word in command.words)
        places = {"ABFM_STATE_FOLDER": str(temporary), "TMPDIR": str(temporary)}
        process = subprocess.Popen(
            [sys.executable, "-c", _MAIN.format(command.module), *words],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            cwd=folder,
            start_new_session=True,
            env=os.environ | places | {"ABFM_TOKEN": token},
            preexec_fn=_take_signals,
        )
        return process, token

    def _life(self, command):
        with tempfile.TemporaryDirectory(dir=self._folder) as folder:
            process, _ = self._start(command, Path(folder))
            _wait_for_handlers(process)
            start = time.monotonic()
            process.communicate(timeout=_PATIENCE)
            return time.monotonic() - start


def _take_signals():
    """Undo what a shell in the background ignores."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_DFL)


def _wait_for_handlers(process):
    """Wait until the last of the signals is caught; False if the process ends before."""
    while process.poll() is None:
        for line in Path(f"/proc/{process.pid}/status").read_text().splitlines():
            if line.startswith("SigCgt:") and int(line.split()[1], 16) >> (signal.SIGHUP - 1) & 1:
                return True
        time.sleep(0.001)
    return False


def _send(process, number, mode, after, pause):
    """Whether the process was there to get a signal."""
    if not _wait_for_handlers(process):
        return False
    with suppress(subprocess.TimeoutExpired):
        process.wait(after)
        return False
    send = os.killpg if mode == "group" else os.kill
    send(process.pid, number)
    if mode == "twice":
        time.sleep(pause)
        if process.poll() is None:
            process.send_signal(number)
    return True


def _left(folder, files, needs_result):
    """What is wrong with the files that a command left."""
    left = {path.name for path in folder.iterdir()} - {"tmp"}
    kept = {"recent.json", "preferences.json"}
    temporary = {path.name for path in (folder / "tmp").iterdir()} - kept
    yield from (f"{name} is left" for name in sorted(left - set(files)))
    yield from (f"{name} is left in the folder for temporary files" for name in sorted(temporary))
    results = [name for name in sorted(left) if name.endswith(".npz")]
    for name in results:
        try:
            load_match(folder / name)
        except AbfmError as error:
            yield f"{name} does not load: {error}"
    for name in sorted(left - set(results)):
        if (folder / name).stat().st_size == 0:
            yield f"{name} is empty"
    if needs_result and not results:
        yield "the best result is lost"


def _processes(token):
    """Command lines of what an ended process has left, after a moment to end in."""
    for _ in range(40):
        found = list(_with_token(token))
        if not found:
            break
        time.sleep(0.05)
    return found


def _with_token(token):
    for path in Path("/proc").iterdir():
        with suppress(OSError):  # it has ended, or is another user's
            if path.name.isdecimal() and token.encode() in (path / "environ").read_bytes():
                words = (path / "cmdline").read_bytes().replace(b"\0", b" ")
                yield words.decode(errors="replace")[:100]


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        run(Attack(Path(folder)).attempt, __doc__)
