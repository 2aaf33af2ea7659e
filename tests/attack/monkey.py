"""Random use of the window: sequences of all actions of a user.

A sequence ends when nothing is computed any more. Undoing all steps must then restore the document
at the beginning of the sequence. The window stays open from one sequence to the next.
"""

import re
import tempfile
import threading
import time
import traceback
from contextlib import ExitStack
from dataclasses import fields, replace
from pathlib import Path
from unittest.mock import patch

from abfm import FunctionError
from abfm_viewer.automation import Driver
from abfm_viewer.errors import DriverError
from tests.attack.specimens import specimens
from tests.attack.trial import FaultError, Trial
from tests.mesh_writers import write
from tests.shapes import ellipsoid

# frames of at least 5 ms, within which everything must end
_FRAMES_MAX, _LINE_MAX, _THREADS_MAX = 3000, 1000, 20
_BUG = re.compile(r"\b(Type|Key|Index|Attribute|Value|Runtime|Assertion|Name|Lookup)Error: ")
_ENDS = ("Go back", "Cancel", "Close", "OK", "Later", "No", "Don't replace")
_UNUSED = ("Samples", "Movie...", "Picture...", "iterations", "UI scale", "Quit")
_CLICKED = ("button", "checkbox", "combo", "tab", "section", "menu", "item", "choice")
_SOLVER = ("Match", "Pause", "Resume", "Cancel")
_OUTPUTS = ("out.npz", "out.ply", "out.vtu", "out.csv", "out.nothing", "no/such/folder/out.npz")
_NONSENSE = (
    *("", " ", "%s%n", "\\", "9" * 500, "nan", "inf", "-1", "0", "0.5", "1e-300", "1e300", "1,5"),
    *("abc", "🦆", "gaussian:", "gaussian:vertex=1", "gaussian:vertex=999999,width=0.2"),
    *("eigenfunction:2", "expression:1/0", "expression:sin(5*x)*z", "file:nothing.npy"),
    *("geodesic:vertex=3", "curvature:mean", "coordinate:x + coordinate:y"),
)
_KEYS = (
    *("ctrl+z", "ctrl+y", "ctrl+shift+z", "space", "left", "right", "home", "end", "esc", "tab"),
    *("enter", "ctrl+enter", "ctrl+s", "ctrl+o", "ctrl+q", "up", "down", "f1", *"plarwf123"),
)
_ACTIONS = [
    *(20 * ["click"] + 4 * ["key", "slide", "type"] + 3 * ["wait", "pick", "open"]),
    "export",
]


class Monkey(ExitStack):
    """One window, and the files that it opens and writes; a context manager."""

    def __enter__(self):
        self._faults, enter = {}, self.enter_context
        self.folder = Path(enter(tempfile.TemporaryDirectory(prefix="abfm-monkey-")))
        self.files = monkey_files(self.folder)
        enter(patch.object(traceback, "print_exc", self._note_printed))
        enter(patch.object(threading, "excepthook", self._note_ended))
        mesh = ellipsoid(2, 1.0, 0.7, 0.55)
        self.gui = enter(Driver(mesh, backend="openGL_mock", size=(1100, 800)))
        self.gui.window.dialogs.start_in(self.folder)
        return self

    def _note_printed(self, *_, **__):
        self._fault(f"printed: {traceback.format_exc()[-400:]}")

    def _note_ended(self, raised):
        self._fault(f"a thread: {raised.exc_type.__name__}: {raised.exc_value}")

    def attempt(self, chance):
        """Make one sequence of random actions."""
        begin, self._faults = time.process_time(), {}
        self._settle()
        self.gui.session.reset_history()
        start = self.gui.session.document
        done = [self._act(chance) for _ in range(chance.randint(5, 25))]
        self._settle()
        self._undo_to(start)
        self._settle()
        self._save_all()
        if threading.active_count() > _THREADS_MAX:
            self._fault(f"{threading.active_count()} threads")
        if self._faults:
            raise FaultError(f"{'; '.join(self._faults)} | {', '.join(done)}")
        return Trial(seconds=time.process_time() - begin)

    def _fault(self, what):
        self._faults[" ".join(what.split())] = None  # an ordered set

    def _act(self, chance):
        """Do a random action; return its description, in brackets if its widget was missing."""
        self.gui.frames(1)
        name = chance.choice(_ACTIONS)
        try:
            done = f"{name} {getattr(self, f'_{name}')(chance) or ''}".strip()
        except (DriverError, FunctionError, IndexError):  # nothing to act on
            done = f"({name})"
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            self._fault(f"{type(error).__name__}: {error} at {where.filename}:{where.lineno}")
            done = name
        self._note_errors()
        return done

    def _usable(self, *kinds):
        """Return the widgets of the last frame that are enabled."""
        drawn = self.gui.window.ui.widgets
        return [w for w in drawn if w.enabled and w.kind in kinds and w.label not in _UNUSED]

    def _click(self, chance):
        """Click on a random widget, and sometimes wait for the end of a match.

        Half of the clicks are on an open menu, list or dialog, or on buttons of the solver.
        """
        found, dialogs = self._usable(*_CLICKED), self.gui.window.dialogs
        first = [w for w in found if w.kind in ("item", "choice") or w.label in _SOLVER]
        widget = chance.choice(first if chance.random() < 0.5 and not dialogs.is_open else found)
        self.gui._click_on(widget)
        if widget.label == "Match" and chance.random() < 0.3:
            self.gui.wait(lambda s: not s.solver.running or s.solver.paused, seconds=20)
        return f"{widget.section}/{widget.label}"

    def _wait(self, chance):
        for _ in range(chance.choice((1, 5, 20, 60))):
            self.gui.frames(1)

    def _key(self, chance):
        key = chance.choice(_KEYS)
        self.gui.key(key)
        return key

    def _slide(self, chance):
        widget = chance.choice(self._usable("slider"))
        value = chance.choice((widget.ends.low, widget.ends.high))
        self.gui.drag(widget.label, value, within=widget.section.split("/")[-1])
        return f"{widget.label} {value:.3g}"

    def _type(self, chance):
        widget, text = chance.choice(self._usable("box")), chance.choice(_NONSENSE)
        self.gui.type(
            widget.label, text, within=widget.section.split("/")[-1], enter=chance.random() < 0.8
        )
        return f"{widget.label} {text[:40]!r}"

    def _pick(self, chance):
        ids = self.gui.session.surface().mesh.vertex_ids
        vertices = [int(chance.choice(ids)) for _ in range(chance.choice((1, 1, 3)))]
        side, keys = (
            chance.choice(("source", "target", "advected")),
            chance.choice((("shift",), ())),
        )
        if chance.random() < 0.3:
            self.gui.wheel(chance.choice((-5, 5)), vertices[0], side, keys)
        else:
            self.gui.drag_on_surface(vertices, side, keys)
        return f"{side} {vertices}"

    def _open(self, chance):
        path = chance.choice(self.files)
        self.gui.window._dropped([str(path)])
        self._wait(chance)
        return path.name

    def _export(self, chance):
        name = chance.choice(_OUTPUTS)
        self.gui.click("Match data...")
        self.gui.click("Save as...")
        self.gui.type("file name", str(self.folder / name))
        self.gui.click("Close", within="Export to a file")
        return name

    def _note_errors(self):
        for part, error in self.gui.errors.items():
            self._fault(f"{part}: {error}")

    def _settle(self):
        """Leave dialogs, end all work, and check the reports."""
        gui, window, session = self.gui, self.gui.window, self.gui.session
        for _ in range(20):
            gui.frames(1)
            if not window.dialogs.is_open:
                break
            ends = [w for w in self._usable("button") if w.label in _ENDS]
            gui._click_on(min(ends, key=lambda w: _ENDS.index(w.label))) if ends else gui.key("esc")
        session.solver.cancel()
        if window.exporter.running:
            window.exporter.cancel()
        quiet = 0
        for _ in range(_FRAMES_MAX):
            session.player.playing = False
            gui.frames(1)
            quiet = 0 if self._at_work() else quiet + 1
            if quiet > 2:
                break
            time.sleep(0.005)
        else:
            self._fault(f"no end of: {self._at_work()}")
        self._note_errors()
        for entry in session.notices.log:
            if entry.kind == "error" and (_BUG.search(entry.text) or len(entry.text) > _LINE_MAX):
                self._fault(f"reported: {entry.text[:300]}")
        session.notices.log.clear()
        for card in session.notices.cards:
            session.notices.dismiss(card)

    def _at_work(self):
        window, session = self.gui.window, self.gui.session
        at_work = {
            "solver": session.solver.running,
            window.shown.busy: True,
            "transport": window.shown.mass_transport.busy,
            "quantities": window.shown.quantities.busy,
            "files": window.files.saving or window.files.waiting is not None,
            "export": window.exporter.running,
        }
        return ", ".join(what for what, is_so in at_work.items() if what and is_so)

    def _undo_to(self, start):
        session, editor = self.gui.session, self.gui.session.editor
        while label := editor.undo_label:
            actions = editor.action_count
            session.undo()
            self.gui.frames(1)
            if editor.action_count == actions:
                self._fault(f"undo of {label!r} did nothing: {session.notices.latest.text}")
                return
        if differing := differences(start, session.document):
            self._fault(f"undo left other {', '.join(differing)}")

    def _save_all(self):
        """Save every unsaved document to a file, as when the window closes."""
        window, saves = self.gui.window, self.gui.session.saves
        for _ in range(2):  # if a result was undone, this differs from the file with the result
            for number, document in enumerate(saves.unsaved_documents):
                window.files.save(self.folder / f"left-{number}.abfm", document=document)
            self._settle()
        if saves.unsaved_documents:
            self._fault(f"not saved: {[each.name for each in saves.unsaved_documents]}")


def differences(one, other):
    """Return the names of fields that differ in two documents, except fields that undo ignores."""
    one, other = (
        replace(each, view=replace(each.view, viewpoint=None, enlarged=""), time=0.0)
        for each in (one, other)
    )
    names = [each.name for each in fields(one)]
    return [name for name in names if getattr(one, name) != getattr(other, name)]


def monkey_files(folder):
    """Write files for the window to open; return valid paths three times, broken ones once."""
    (folder / "folder.off").mkdir()
    contents = {name: specimens()[name].content for name in ("a.off", "result.npz", "plain.abfm")}
    good = [write(folder, name, content) for name, content in contents.items()]
    cases = [(name, content[:end]) for name, content in contents.items() for end in (0, 200)]
    bad = [write(folder, f"{len(content)}-{name}", content) for name, content in cases]
    return [*(3 * good), *bad, folder / "nothing.off", folder / "folder.off"]
