"""Signals at random moments of every command: one line, the status that shells know, whole files,
nothing left behind.

A command first runs undisturbed, which says how long it lives; a signal comes between the moment
when the program has taken its signals over (Python's own start is before that) and a little after
that life. Linux only: what catches which signal, and which processes are left, is read from /proc.
"""

from __future__ import annotations

import os
import random
import secrets
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from abfm import AbfmError, Parameters, load_match, load_mesh, match
from abfm.assets import asset_path
from tests.attack.trial import Trial, run

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# to the process alone, as a terminal does it, and a second one soon after
MODES = ("process", "group", "twice")
PAIR = "--source gaussian:vertex=10,width=0.2 --target gaussian:vertex=40,width=0.2 --quiet"
STOPPING, INTERRUPTED = (
    "stopping with the best result so far; Ctrl-C again to leave at once",
    "interrupted",
)
REPORTED = "stopping with what was finished; Ctrl-C again to leave at once"
_MAIN = "import sys; from abfm_viewer.{} import main; sys.exit(main())"
_PATIENCE = 60.0  # seconds after which a process does not end


@dataclass(frozen=True)
class Command:
    """A command line, the files that it may leave, and how long it may run if nobody ends it."""

    line: str
    files: tuple[str, ...] = ()
    statuses: tuple[int, ...] = (0,)  # of a run that ends by itself
    module: str = "cli"
    lasts: float = 0.0  # seconds after the start; 0: to its end


MOVIE = "--size 320x240 --seconds 0.3 --quiet"
ENDLESS = f"match MESH {PAIR} --iterations 1000000 --tolerance 0 --sigma 1e-6 --out m.npz"
BRIEF = f"match MESH {PAIR} --iterations 3 --out m.npz --out m.vtu"
DEMO, FIGURE = ("demo.npz", "demo.png", "demo.mp4"), ("figure-3.png", "figure-3.json")
COMMANDS = {
    "help": Command("match --help"),
    "info": Command("info MESH"),
    "match": Command(ENDLESS, ("m.npz",), (3,), lasts=4.0),
    "short match": Command(BRIEF, ("m.npz", "m.vtu"), (3,)),
    "map": Command("map RESULT --out map.txt", ("map.txt",)),
    "picture": Command("render RESULT --out m.png --size 320x240", ("m.png",)),
    "mp4": Command(f"render RESULT --out m.mp4 {MOVIE}", ("m.mp4",)),
    "gif": Command(f"render RESULT --out m.gif {MOVIE}", ("m.gif",)),
    "demo": Command("demo --quiet --out .", DEMO, lasts=12.0),
    "figure": Command("figure 3 --mesh MESH --quiet --out .", FIGURE, lasts=8.0),
    "bench": Command("bench --success --only-given --mesh MESH --problems 1 --quiet --json"),
    "window": Command("MESH", statuses=(2,), module="app", lasts=6.0 * ("DISPLAY" in os.environ)),
}


@dataclass
class Outcome:
    """One signal: when it came, and what was wrong with what came of it."""

    command: str
    signal: str
    mode: str
    after: float  # seconds since the program took its signals over
    status: int | None = None
    faults: list[str] = field(default_factory=list)


class Attack:
    """Sends signals to commands that work in a folder of their own.

    Parameters
    ----------
    folder : Path
        Where there is room for them.
    random : random.Random
        Chooses what is sent when.
    lives : mapping, optional
        Seconds that commands take, by their names; of others a whole life is measured first.
    """

    def __init__(
        self, folder: Path, random: random.Random, lives: Mapping[str, float] | None = None
    ) -> None:
        self._folder, self.random = folder, random
        self._mesh, self._result = str(asset_path("eight.off")), folder / "result.npz"
        self._lives = dict(lives or {})
        mesh = load_mesh(self._mesh)
        x, y, _ = mesh.vertices.T
        match(mesh, x, y, Parameters(iterations=2, levels=1)).save(self._result)

    def one(self, name: str) -> Outcome:
        """Send one signal to a command, and look at what comes of it."""
        command = COMMANDS[name]
        if name not in self._lives:
            self._lives[name] = command.lasts or self._life(command)
        number, mode = self.random.choice(SIGNALS), self.random.choice(MODES)
        outcome = Outcome(name, number.name, mode, 1.02 * self._lives[name] * self.random.random())
        with tempfile.TemporaryDirectory(dir=self._folder) as place:
            folder = Path(place)
            process, token = self._start(command, folder)
            pause = self.random.choice([0.0, 0.01, 0.3])
            was_there = self._send(process, number, mode, outcome.after, pause)
            try:
                _, errors = process.communicate(timeout=_PATIENCE)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                _, errors = process.communicate()
                outcome.faults.append(f"it did not end within {_PATIENCE:g} s")
            outcome.status = process.returncode
            self._judge(command, outcome, number, was_there, errors)
            outcome.faults += _left(folder, command.files, STOPPING in errors and mode != "twice")
            outcome.faults += [f"a process is left: {words}" for words in _processes(token)]
        return outcome

    def _start(self, command: Command, folder: Path) -> tuple[subprocess.Popen[str], str]:
        token = secrets.token_hex(8)
        places = {"MESH": self._mesh, "RESULT": str(self._result)}
        temporary = folder / "tmp"
        temporary.mkdir(exist_ok=True)
        words = (places.get(word, word) for word in command.line.split())
        process = subprocess.Popen(
            [sys.executable, "-c", _MAIN.format(command.module), *words],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            cwd=folder,
            start_new_session=True,
            env=os.environ
            | {"ABFM_STATE_FOLDER": str(temporary), "TMPDIR": str(temporary), "ABFM_TOKEN": token},
            preexec_fn=_take_signals,
        )
        return process, token

    def _life(self, command: Command) -> float:
        with tempfile.TemporaryDirectory(dir=self._folder) as folder:
            process, _ = self._start(command, Path(folder))
            _wait_for_handlers(process)
            start = time.monotonic()
            process.communicate(timeout=_PATIENCE)
            return time.monotonic() - start

    def _send(
        self,
        process: subprocess.Popen[str],
        number: signal.Signals,
        mode: str,
        after: float,
        pause: float,
    ) -> bool:
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

    def _judge(
        self, command: Command, outcome: Outcome, number: int, was_there: bool, errors: str
    ) -> None:
        lines, status = errors.splitlines(), outcome.status
        ended_by_itself = status in command.statuses
        if not (ended_by_itself or (was_there and status == 128 + number)):
            outcome.faults.append(f"status {status}")
        program = "abfm-viewer" if command.module == "app" else "abfm"
        expected = [f"{program}: {INTERRUPTED}", STOPPING, REPORTED]
        if not ended_by_itself and (
            (not lines and outcome.mode != "twice") or set(lines) - set(expected)
        ):
            outcome.faults.append(f"stderr: {errors[-300:]!r}")


def _take_signals() -> None:
    """Undo what a shell in the background ignores."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_DFL)


def _wait_for_handlers(process: subprocess.Popen[str]) -> bool:
    """Wait until the last of the signals is caught; False if the process ends before."""
    while process.poll() is None:
        for line in Path(f"/proc/{process.pid}/status").read_text().splitlines():
            if line.startswith("SigCgt:") and int(line.split()[1], 16) >> (signal.SIGHUP - 1) & 1:
                return True
        time.sleep(0.001)
    return False


def _left(folder: Path, files: tuple[str, ...], needs_result: bool) -> Iterator[str]:
    """What is wrong with the files that a command left."""
    left = {path.name for path in folder.iterdir()} - {"tmp"}
    temporary = {path.name for path in (folder / "tmp").iterdir()} - {
        "recent.json",
        "preferences.json",
    }
    yield from (f"{name} is left" for name in sorted(left - set(files)))
    yield from (f"{name} is left in the folder for temporary files" for name in sorted(temporary))
    for name in sorted(left):
        if name.endswith(".npz"):
            try:
                load_match(folder / name)
            except AbfmError as error:
                yield f"{name} does not load: {error}"
        elif (folder / name).stat().st_size == 0:
            yield f"{name} is empty"
    if needs_result and not {name for name in left if name.endswith(".npz")}:
        yield "the best result is lost"


def _processes(token: str) -> list[str]:
    """Command lines of the processes that an ended one has left, after a moment in which they
    may end.
    """
    found: list[str] = []
    for _ in range(40):
        found = list(_with_token(token))
        if not found:
            break
        time.sleep(0.05)
    return found


def _with_token(token: str) -> Iterator[str]:
    for path in Path("/proc").iterdir():
        if path.name.isdecimal():
            try:
                if token.encode() in (path / "environ").read_bytes():
                    yield (
                        (path / "cmdline")
                        .read_bytes()
                        .replace(b"\0", b" ")
                        .decode(errors="replace")[:100]
                    )
            except OSError:  # it has ended, or is another user's
                pass


def main() -> None:
    """Send signals, a line of JSON each."""
    with tempfile.TemporaryDirectory() as folder:
        attack = Attack(Path(folder), random.Random())

        def attempt(seed: int) -> Trial:
            chosen = attack.random = random.Random(seed)
            outcome = attack.one(chosen.choice(list(COMMANDS)))
            kind = f"{outcome.command}, {outcome.signal} {outcome.mode} after {outcome.after:.3f} s"
            return Trial(kind, seed, "fault" if outcome.faults else "ok", "; ".join(outcome.faults))

        run(attempt, __doc__)


if __name__ == "__main__":
    main()
