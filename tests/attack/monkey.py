"""A monkey at the window: random sequences of what a user can do, each given by its seed.

``python -m tests.attack.monkey --seed S --count N`` prints a line for each (see
`tests.attack.trial`). A sequence ends by waiting until nothing is computed any more, and by undoing
everything, which must lead back to where it began. The window lives on from one sequence to the
next, and its unsaved work is saved in between, as somebody would who works all day. ``--apart``
matches and evaluates in processes, as a real window does on large meshes. A run of more than five
minutes tells at its end what the window has then and had after those, and ends with 1 if that is
more by a tenth.
"""

import io
import random
import re
import resource
import sys
import tempfile
import threading
import time
import traceback
from collections import deque
from contextlib import ExitStack, contextmanager
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

import abfm
from abfm.workers import threads
from abfm_viewer.automation import Driver
from abfm_viewer.computing import evaluation
from abfm_viewer.document.document import Document, Surface
from abfm_viewer.errors import DriverError
from abfm_viewer.files.project import save_project
from tests.attack.monkey_actions import ACTIONS, LEFT_ALONE
from tests.attack.trial import Trial, asked_for
from tests.mesh_writers import off_text, write
from tests.processes import children
from tests.shapes import ellipsoid, icosphere

_LENGTH = (5, 25)  # actions of a sequence, at least and at most
# frames of 5 ms, and as long as they take, in which everything must come to its end
_PATIENCE = 3000
_LONGEST_LINE = 1000
_MOST_MEMORY = 6 << 30  # bytes of address space
# seconds, and what there may be at the end over what there was after them
_EARLY, _MOST_GROWTH = 300.0, 1.1
_BUG = re.compile(
    r"\b(Type|Key|Index|Attribute|Value|Runtime|Assertion|Name|Lookup|Arithmetic|Recursion)Error: "
)
_ENDS = ("Go back", "Cancel", "Close", "OK", "Later", "No", "Don't replace")


class Monkey:
    """One window, and the files that it opens and writes; a context manager."""

    def __init__(self, apart):
        self._closing = ExitStack()
        self._apart = apart
        self._faults = []

    def __enter__(self):
        opened = self._closing
        self.folder = Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="abfm-monkey-")))
        mesh = ellipsoid(2, 1.0, 0.7, 0.55)
        if self._apart:
            before, evaluation.OWN_PROCESS_FROM = evaluation.OWN_PROCESS_FROM, 100
            opened.callback(setattr, evaluation, "OWN_PROCESS_FROM", before)
        self.files = monkey_files(self.folder)
        opened.enter_context(self._watched())
        self.gui = opened.enter_context(Driver(mesh, backend="openGL_mock", size=(1100, 800)))
        self.gui.window.dialogs.folder = self.folder
        self._settle()
        self.gui.session.reset_history()
        return self

    def __exit__(self, *_):
        self._closing.close()

    def sequence(self, seed):
        """The trial of a seed."""
        began, chance = time.process_time(), random.Random(seed)
        self._faults = []
        self._settle()
        self.gui.session.reset_history()
        start = self.gui.session.document
        done = [self._act(chance) for _ in range(chance.randint(*_LENGTH))]
        self._settle()
        self._undo_to(start)
        self._settle()
        self._save_all()
        faults = "; ".join(self._faults)
        kind = "monkey/apart" if self._apart else "monkey"
        detail = faults and f"{faults} | {', '.join(done)}"
        seconds, now = round(time.process_time() - began, 3), counts()
        kept = {"threads": now["threads"], "resident": now["megabytes"]}
        return Trial(kind, seed, "fault" if faults else "ok", detail, seconds, **kept)

    def _fault(self, what):
        text = " ".join(what.split())
        if text not in self._faults:
            self._faults.append(text)

    def _tell_errors(self):
        for part, error in self.gui.errors.items():
            self._fault(f"{part}: {error}")

    def _act(self, chance):
        """Do something, and say what; in brackets if its widget was gone or grey."""
        self.gui.frames(1)
        possible = {name: each for name, each in ACTIONS.items() if each.is_possible(self)}
        [name] = chance.choices(list(possible), [each.weight for each in possible.values()])
        done = name
        try:
            done = f"{name} {possible[name].act(self, chance) or ''}".strip()
        except DriverError:
            done = f"({name})"
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            owner = "driver" if "automation" in where.filename else "window"
            place = f"{Path(where.filename).name}:{where.lineno}"
            self._fault(f"{owner}: {type(error).__name__}: {error} at {place}")
        self._tell_errors()
        return done

    def usable(self, *kinds, label=""):
        """Widgets of these kinds that were drawn last and are not grey, or those of a label."""
        ready = [w for w in self.gui.window.ui.widgets if w.enabled and w.kind in kinds]
        return [w for w in ready if w.label not in LEFT_ALONE and label in ("", w.label)]

    def widget(self, chance, *kinds, label=""):
        self.gui.frames(1)
        if not (usable := self.usable(*kinds, label=label)):
            raise DriverError("there is no such widget any more")
        return chance.choice(usable)

    def rest(self):
        """Do nothing until threads that wait for work have ended."""
        end = time.monotonic() + 1.5 * threads._IDLE
        while time.monotonic() < end:
            self.gui.frames(1)
            time.sleep(0.05)

    def _settle(self):
        """Let everything come to its end; what does not within many frames is a fault."""
        gui, window, session = self.gui, self.gui.window, self.gui.session
        window.closing = False
        session.player.playing = False
        for _ in range(6):
            if not window.dialogs.is_open:
                break
            self._leave_dialog()
        session.solver.cancel()
        if window.exporter.running:
            window.exporter.cancel()
        quiet = 0
        for _ in range(_PATIENCE):
            session.player.playing = False
            gui.frames(1)
            quiet = 0 if self._at_work() else quiet + 1
            if quiet > 2:
                break
            time.sleep(0.005)
        else:
            self._fault(f"no end of: {self._at_work()}")
        self._tell_errors()
        for entry in session.notices.log:
            is_bug = _BUG.search(entry.text) or len(entry.text) > _LONGEST_LINE
            if entry.kind == "error" and is_bug:
                self._fault(f"told: {entry.text[:300]}")
        session.notices.log.clear()
        for card in session.notices.cards:
            session.notices.dismiss(card)

    def _leave_dialog(self):
        gui = self.gui
        labels = [w.label for w in gui.window.ui.widgets if w.kind == "button" and w.enabled]
        ends = [label for label in _ENDS if label in labels]
        try:
            gui.click(ends[0]) if ends else gui.key("esc")
        except DriverError:
            gui.key("esc")

    def _at_work(self):
        window, session = self.gui.window, self.gui.session
        at_work = {
            "solver": session.solver.running,
            window.shown.busy: True,
            "transport": window.shown.mass_transport.busy,
            "quantities": window.shown.quantities.busy,
            "files": window.files.saving,
            "waiting": window.files.waiting is not None,
            "export": window.exporter.running,
        }
        return ", ".join(what for what, is_so in at_work.items() if what and is_so)

    def _undo_to(self, start):
        session, editor = self.gui.session, self.gui.session.editor
        while label := editor.undo_label:
            moves = editor.moves
            session.undo()
            self.gui.frames(1)
            if editor.moves == moves:
                self._fault(f"undo of {label!r} did nothing: {session.notices.latest.text}")
                return
        if differing := differences(start, session.document):
            self._fault(f"undo left other {', '.join(differing)}")

    def _save_all(self):
        """As one who closes the window: every document that would be lost goes into a file."""
        window, session = self.gui.window, self.gui.session
        # where a result was undone, what is there now differs from the file with the result
        for _ in range(2):
            for number, document in enumerate(session.saves.unsaved_documents):
                window.files.save(self.folder / f"left-{number}.abfm", document=document)
            self._settle()
        if session.saves.unsaved_documents:
            names = ", ".join(document.name for document in session.saves.unsaved_documents)
            self._fault(f"not saved: {names}: {session.notices.latest.text}")

    @contextmanager
    def _watched(self):
        """Exceptions that the app prints, and those that end a thread, are faults."""

        def printed(*_, **__):
            text = io.StringIO()
            traceback.print_exception(*sys.exc_info(), file=text)
            sys.stderr.write(text.getvalue())
            self._fault(f"printed: {text.getvalue()[-400:]}")

        def ended(raised):
            name = raised.thread and raised.thread.name
            self._fault(f"thread {name}: {raised.exc_type.__name__}: {raised.exc_value}")
            hook(raised)

        print_exc, hook = traceback.print_exc, threading.excepthook
        traceback.print_exc, threading.excepthook = printed, ended
        try:
            yield
        finally:
            traceback.print_exc, threading.excepthook = print_exc, hook


def differences(one, other):
    """What two documents differ in, apart from what is no step of undo."""
    steady = [replace(d.view, look=None, large="") for d in (one, other)]
    one, other = (replace(d, view=v, time=0.0) for d, v in zip((one, other), steady, strict=True))
    names = [each.name for each in fields(Document)]
    return [name for name in names if getattr(one, name) != getattr(other, name)]


def monkey_files(folder):
    """Files to open: good ones three times as often as broken ones."""
    chance = random.Random(0)
    sphere, egg = icosphere(1), ellipsoid(2, 1.0, 0.8, 0.6)
    corners = np.array([[x, y, 0.1 * x * y] for x in range(5) for y in range(5)], dtype=float)
    quads = [5 * x + y for x in range(4) for y in range(4)]
    patch = np.array([f for q in quads for f in ((q, q + 5, q + 1), (q + 1, q + 5, q + 6))])
    good = [
        write(folder, "sphere.off", off_text(sphere.vertices, sphere.faces)),
        write(folder, "egg.off", off_text(egg.vertices, egg.faces)),
        write(folder, "patch.off", off_text(corners, patch)),
        *(folder / name for name in ("result.npz", "project.abfm")),
    ]
    f, g = (abfm.function(sphere, f"gaussian:vertex={vertex},width=0.3") for vertex in (1, 8))
    abfm.match(sphere, f, g, abfm.Parameters(iterations=5)).save(good[3])
    save_project(good[4], Document((Surface(sphere, "sphere.off"),), time=0.5), {})
    bad = []
    for path in good:
        content = path.read_bytes()
        flipped = bytearray(content)
        for place in (chance.randrange(len(content)) for _ in range(20)):
            flipped[place] ^= 1 << chance.randrange(8)
        half, broken = content[: len(content) // 2], bytes(flipped)
        for word, changed in (("cut", half), ("flipped", broken), ("empty", b"")):
            bad.append(write(folder, f"{path.stem}-{word}{path.suffix}", changed))
    vertices = np.vstack([sphere.vertices, sphere.vertices + 5])
    faces = np.vstack([sphere.faces, sphere.faces + 42])
    bad += [write(folder, "two.off", off_text(vertices, faces)), folder / "nothing.off"]
    bad += [write(folder, "text.txt", "a text"), folder / "folder.off"]
    bad[-1].mkdir()
    return [*good, *good, *good, *bad]


def counts():
    """What the process has at present: threads, children, and megabytes that are resident."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    megabytes = round(pages * resource.getpagesize() / 2**20, 1)
    return {
        "threads": threading.active_count(),
        "children": len(children()),
        "megabytes": megabytes,
    }


class Endurance:
    """What the window keeps after its first five minutes and at the end: of memory the least that
    some sequences leave, of threads and processes what is there after a rest.
    """

    def __init__(self, begun, rest):
        self._begun, self._rest = begun, rest
        self._megabytes = deque(maxlen=50)
        self._early = None

    def add(self):
        """Look at what there is after one more sequence."""
        self._megabytes.append(counts()["megabytes"])
        if self._early is None and time.monotonic() - self._begun > _EARLY:
            self._early = self._kept()

    def _kept(self):
        self._rest()
        return counts() | {"megabytes": min(self._megabytes)}

    def end(self):
        """Tell of both, and whether what there is at the end is not more by over a tenth."""
        if self._early is None:
            return True
        early, late = self._early, self._kept()
        print(f"# after {_EARLY / 60:g} minutes: {early}; at the end: {late}", file=sys.stderr)
        return all(late[name] <= _MOST_GROWTH * early[name] for name in late)


def main():
    """The program; its exit status."""
    longer = {"type": float, "default": 0.0, "help": "so long at least, with further seeds"}
    apart = {"action": "store_true", "help": "match and evaluate in processes"}
    asked = asked_for(__doc__, minutes=longer, apart=apart)
    resource.setrlimit(resource.RLIMIT_AS, (_MOST_MEMORY, _MOST_MEMORY))
    began, seed = time.monotonic(), asked.seed
    with Monkey(asked.apart) as monkey:
        endurance = Endurance(began, monkey.rest)
        while seed < asked.seed + asked.count or time.monotonic() - began < 60 * asked.minutes:
            if time.monotonic() - began > asked.seconds:
                break
            print(monkey.sequence(seed).to_line(), flush=True)
            endurance.add()
            seed += 1
            if (seed - asked.seed) % 50 == 0:
                said = f"{seed - asked.seed} sequences, {time.monotonic() - began:.0f} s"
                print(f"# {said}: {counts()}", file=sys.stderr)
        return 0 if endurance.end() else 1


if __name__ == "__main__":
    sys.exit(main())
