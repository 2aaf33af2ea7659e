"""A monkey at the window: random sequences of what a user can do, each given by its seed.

``python -m tests.attack.monkey --seed S --count N`` prints a line for each (see `tests.attack.trial`). A sequence ends
by waiting until nothing is computed any more, and by undoing everything, which must lead back to where it began. The
window lives on from one sequence to the next, and its unsaved work is saved in between, as somebody would who works all
day. ``--apart`` matches and evaluates in processes, as a real window does on large meshes. A run of more than five
minutes tells at its end what the window has then and had after those, and ends with 1 if that is more by a tenth.
"""

from __future__ import annotations

import argparse
import io
import os
import random
import re
import resource
import sys
import tempfile
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from statistics import median

import numpy as np

import abfm
from abfm import FunctionError
from abfm_viewer.automation import Driver
from abfm_viewer.computing import evaluator
from abfm_viewer.document.document import Document
from abfm_viewer.errors import DriverError
from abfm_viewer.files.project import save_project
from abfm_viewer.widgets.widget_record import Widget
from tests.attack.trial import Trial
from tests.mesh_writers import off_text
from tests.shapes import ellipsoid, icosphere

ACTIONS = (5, 25)
"""How many a sequence has, at least and at most."""
_PATIENCE = 3000  # frames of 5 ms, and as long as they take, in which everything must come to its end
_LONGEST_LINE = 1000
_EARLY, _MOST_GROWTH = 300.0, 1.1  # seconds, and what there may be at the end over what there was after them
_MOST_MEMORY = 6 << 30  # bytes of address space
_BUG = re.compile(r"\b(?:Type|Key|Index|Attribute|Value|Runtime|Assertion|Name|Lookup|Arithmetic|Recursion)Error: ")
_NONSENSE = (
    "", " ", "nan", "inf", "-inf", "-1", "0", "0.5", "3", "1e-300", "1e300", "1e9", "1,5", "abc", "🦆", "%s%n", "\\",
    "9" * 500, "gaussian:", "gaussian:vertex=1", "gaussian:vertex=999999,width=0.2", "gaussian:vertex=1,width=nan",
    "eigenfunction:2", "eigenfunction:100000", "expression:1/0", "expression:sin(5*x)*z", "expression:x**x**x",
    "file:nothing.npy", "geodesic:vertex=3", "curvature:mean", "coordinate:x + coordinate:y", "permuted:no.txt(x)",
)  # fmt: skip
_KEYS = (
    "ctrl+z", "ctrl+z", "ctrl+y", "ctrl+shift+z", "space", "left", "right", "home", "end", "esc", "esc", "p", "l",
    "f1", "tab", "enter", "ctrl+enter", "ctrl+s", "ctrl+o", "ctrl+q", "up", "down", "a", "r", "w", "f", "1", "2", "3",
)  # fmt: skip
_LEFT_ALONE = ("Samples", "Save movie...", "Save picture...", "iterations", "UI scale", "Quit")
_CLICKED = ("button", "checkbox", "choice", "tab", "section", "item")
_ENDS = ("Go back", "Cancel", "Close", "OK", "Later", "No", "Don't replace")


@dataclass
class Found:
    """What a sequence came to besides its actions."""

    done: list[str] = field(default_factory=list)
    driver: int = 0  # actions that could not be done, as their widget was gone or grey
    faults: list[str] = field(default_factory=list)

    def fault(self, what: str) -> None:
        text = " ".join(what.split())
        if text not in self.faults:
            self.faults.append(text)


class Monkey:
    """One window, and the files that it opens and writes; a context manager."""

    def __init__(self, apart: bool = False, backend: str = "openGL_mock") -> None:
        self._closing = ExitStack()
        self._apart, self._backend = apart, backend
        self.found = Found()

    def __enter__(self) -> Monkey:
        self.folder = Path(self._closing.enter_context(tempfile.TemporaryDirectory(prefix="abfm-monkey-")))
        mesh = ellipsoid(2, 1.0, 0.7, 0.55)
        if self._apart:
            before, evaluator.OWN_PROCESS_FROM = evaluator.OWN_PROCESS_FROM, 100
            self._closing.callback(setattr, evaluator, "OWN_PROCESS_FROM", before)
        self.files = _files(self.folder)
        self._closing.enter_context(self._watched())
        self.gui = self._closing.enter_context(Driver(mesh, backend=self._backend, size=(1100, 800)))
        self.gui.window.dialogs.folder = self.folder
        if self._apart:
            self.gui.session.solver.work_apart()
        self._settle()
        self.gui.session.reset_history()
        return self

    def __exit__(self, *raised: object) -> None:
        self._closing.close()

    def sequence(self, seed: int) -> Trial:
        """The trial of a seed."""
        began, chance = time.process_time(), random.Random(seed)
        self.found = Found()
        self._settle()
        self.gui.session.reset_history()
        start = self.gui.session.document
        for _ in range(chance.randint(*ACTIONS)):
            self._act(chance)
        self._settle()
        self._undo_to(start)
        self._settle()
        self._save_all()
        found = self.found
        detail = "; ".join(found.faults) and f"{'; '.join(found.faults)} | {', '.join(found.done)}"
        return Trial(
            "monkey/apart" if self._apart else "monkey",
            seed,
            "fault" if found.faults else "ok",
            detail,
            round(time.process_time() - began, 3),
            threads=threading.active_count(),
            resident=counts()["megabytes"],
        )

    # What is done

    def _act(self, chance: random.Random) -> None:
        self.gui.frames(1)
        possible = {name: each for name, each in _ACTIONS.items() if each.is_possible(self)}
        [name] = chance.choices(list(possible), [each.weight for each in possible.values()])
        act = possible[name].act
        done = name
        try:
            done = f"{name} {act(self, chance) or ''}".strip()
        except DriverError:
            self.found.driver += 1
            done = f"({name})"
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            owner = "driver" if "automation" in where.filename else "window"
            self.found.fault(f"{owner}: {type(error).__name__}: {error} at {Path(where.filename).name}:{where.lineno}")
        self.found.done.append(done)
        for part, error_line in self.gui.errors.items():
            self.found.fault(f"{part}: {error_line}")

    def usable(self, *kinds: str, label: str = "") -> list[Widget]:
        """Widgets of these kinds that were drawn last and are not grey, or those of a label."""
        drawn = [w for w in self.gui.window.ui.widgets if w.enabled and w.kind in kinds and w.label not in _LEFT_ALONE]
        return [w for w in drawn if not label or w.label == label]

    def widget(self, chance: random.Random, *kinds: str, label: str = "") -> Widget:
        self.gui.frames(1)
        if not (usable := self.usable(*kinds, label=label)):
            raise DriverError("there is no such widget any more")
        return chance.choice(usable)

    # How it ends

    def _settle(self) -> None:
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
            if quiet > 5:
                break
            time.sleep(0.005)
        else:
            self.found.fault(f"no end of: {self._at_work()}")
        for part, error in gui.errors.items():
            self.found.fault(f"{part}: {error}")
        for entry in session.log:
            if entry.kind == "error" and (_BUG.search(entry.text) or len(entry.text) > _LONGEST_LINE):
                self.found.fault(f"told: {entry.text[:300]}")
        session.log.clear()  # type: ignore[attr-defined]
        for card in session.cards:
            session.dismiss(card)

    def _leave_dialog(self) -> None:
        gui = self.gui
        labels = [w.label for w in gui.window.ui.widgets if w.kind == "button" and w.enabled]
        ends = [label for label in _ENDS if label in labels]
        try:
            gui.click(ends[0]) if ends else gui.key("esc")
        except DriverError:
            gui.key("esc")

    def _at_work(self) -> str:
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

    def _undo_to(self, start: Document) -> None:
        session = self.gui.session
        while session.history.undo_label:
            label, moves = session.history.undo_label, session.history.moves
            session.undo()
            self.gui.frames(1)
            if session.history.moves == moves:
                self.found.fault(f"undo of {label!r} did nothing: {session.notice.text}")
                return
        if differing := differences(start, session.document):
            self.found.fault(f"undo left other {', '.join(differing)}")

    def _save_all(self) -> None:
        """As one who closes the window: every document that would be lost goes into a file."""
        window, session = self.gui.window, self.gui.session
        for _ in range(2):  # where a result was undone, what is there now differs from the file with the result
            for number, document in enumerate(session.unsaved_documents):
                window.files.save(self.folder / f"left-{number}.abfm", document=document)
            self._settle()
        if session.unsaved_documents:
            names = ", ".join(document.name for document in session.unsaved_documents)
            self.found.fault(f"not saved: {names}: {session.notice.text}")

    @contextmanager
    def _watched(self) -> Iterator[None]:
        """Exceptions that the app prints, as it lives on, and those that end a thread, are faults."""

        def printed(*_: object, **__: object) -> None:
            text = io.StringIO()
            traceback.print_exception(*sys.exc_info(), file=text)
            sys.stderr.write(text.getvalue())
            self.found.fault(f"printed: {text.getvalue()[-400:]}")

        def ended(raised: threading.ExceptHookArgs) -> None:
            self.found.fault(
                f"thread {raised.thread and raised.thread.name}: {raised.exc_type.__name__}: {raised.exc_value}"
            )
            hook(raised)

        print_exc, hook = traceback.print_exc, threading.excepthook
        traceback.print_exc, threading.excepthook = printed, ended
        try:
            yield
        finally:
            traceback.print_exc, threading.excepthook = print_exc, hook


def differences(one: Document, other: Document) -> list[str]:
    """What two documents differ in; how surfaces are turned and the time that plays are not steps of undo."""
    seen = {"look": None, "large": "", "front": None}
    one, other = (replace(each, view=replace(each.view, **seen), time=0.0) for each in (one, other))
    differing = []
    for each in fields(Document):
        mine, theirs = getattr(one, each.name), getattr(other, each.name)
        if mine is not theirs and (each.name in ("mesh", "result") or mine != theirs):
            differing.append(each.name)
    return differing


# The actions: each does something, and may say what in a few words


def _press(label: str) -> Callable[[Monkey, random.Random], str]:
    def press(monkey: Monkey, chance: random.Random) -> str:
        monkey.gui._click(monkey.widget(chance, "button", label=label))
        return ""

    return press


def _wait(monkey: Monkey, chance: random.Random) -> str:
    count = chance.choice((1, 2, 5, 20, 60))
    for _ in range(count):
        monkey.gui.frames(1)
        time.sleep(0.002)
    return str(count)


def _key(monkey: Monkey, chance: random.Random) -> str:
    key = chance.choice(_KEYS)
    monkey.gui.key(key)
    return key


def _slide(monkey: Monkey, chance: random.Random) -> str:
    widget = monkey.widget(chance, "slider")
    share = chance.choice((0.0, 1.0, chance.random()))
    value = widget.low + share * (widget.high - widget.low)
    monkey.gui.drag(widget.label, min(max(value, widget.low), widget.high), within=_within(widget))
    return f"{widget.label} {value:.3g}"


def _type(monkey: Monkey, chance: random.Random) -> str:
    widget, text = monkey.widget(chance, "box"), chance.choice(_NONSENSE)
    monkey.gui.type(widget.label, text, within=_within(widget), enter=chance.random() < 0.8)
    return f"{widget.label} {text[:40]!r}"


def _choose(monkey: Monkey, chance: random.Random) -> str:
    widget = monkey.widget(chance, "combo")
    monkey.gui.click(widget.label, within=_within(widget))
    choices = [w.label for w in monkey.gui.window.ui.widgets if w.kind == "choice" and widget.label in w.section]
    if not choices:
        monkey.gui.key("esc")
        return widget.label
    choice = chance.choice(choices)
    monkey.gui.click(choice, within=widget.name or widget.label)
    return f"{widget.label} {choice}"


def _click(monkey: Monkey, chance: random.Random) -> str:
    widget = monkey.widget(chance, *_CLICKED)
    monkey.gui.click(widget.label, within=_within(widget))
    return f"{widget.section}/{widget.label}"


def _menu(monkey: Monkey, chance: random.Random) -> str:
    menu = monkey.widget(chance, "menu").label
    monkey.gui.click(menu)
    for _ in range(3):
        items = [
            w
            for w in monkey.gui.window.ui.widgets
            if w.kind in ("item", "menu") and w.section and w.enabled and w.label not in _LEFT_ALONE
        ]
        if not items:
            break
        chosen = chance.choice(items)
        monkey.gui._click(chosen)
        if chosen.kind == "item":
            return f"{menu}/{chosen.label}"
    monkey.gui.key("esc")
    return menu


def _tab(monkey: Monkey, chance: random.Random) -> str:
    tab = chance.choice(("Functions", "Match", "Look", "Export"))
    monkey.gui.window.ui.show_tab(tab)
    monkey.gui.frames(2)
    return tab


def _pick(monkey: Monkey, chance: random.Random) -> str:
    ids = monkey.gui.session.mesh.vertex_ids
    vertices = [int(chance.choice(ids)) for _ in range(chance.choice((1, 1, 3)))]
    side, modifiers = chance.choice(("source", "target", "advected")), chance.choice((("shift",), ("shift",), ()))
    try:
        monkey.gui.drag_on_surface(vertices, side, modifiers)
    except FunctionError as error:  # another mesh came meanwhile
        raise DriverError(str(error)) from error
    return f"{side} {vertices}"


def _wheel(monkey: Monkey, chance: random.Random) -> str:
    modifiers = chance.choice((("shift",), ()))
    vertex = int(chance.choice(monkey.gui.session.mesh.vertex_ids))
    try:
        monkey.gui.wheel(chance.uniform(-5, 5), vertex, chance.choice(("source", "target")), modifiers)
    except FunctionError as error:
        raise DriverError(str(error)) from error
    return ""


def _open(monkey: Monkey, chance: random.Random) -> str:
    path = chance.choice(monkey.files)
    monkey.gui.window._dropped([str(path)])
    for _ in range(chance.choice((0, 3, 30))):
        monkey.gui.frames(1)
        time.sleep(0.003)
    return path.name


def _answer(monkey: Monkey, chance: random.Random) -> str:
    return _click(monkey, chance)


def _export(monkey: Monkey, chance: random.Random) -> str:
    name = chance.choice(("out.npz", "out.ply", "out.vtu", "out.csv", "out.nothing", "no/such/folder/out.npz"))
    monkey.gui.click("Save result...")
    monkey.gui.type("file name", str(monkey.folder / name))
    return name


def _match(monkey: Monkey, chance: random.Random) -> str:
    monkey.gui._click(monkey.widget(chance, "button", label="Match"))
    _wait(monkey, chance)
    if chance.random() < 0.5:
        monkey.gui.wait(lambda session: not session.solver.running or session.solver.paused, seconds=20)
        return "to its end"
    return ""


def _labelled(label: str) -> Callable[[Monkey], bool]:
    return lambda monkey: bool(monkey.usable("button", label=label))


def _there(*kinds: str) -> Callable[[Monkey], bool]:
    return lambda monkey: bool(monkey.usable(*kinds))


def _asked(monkey: Monkey) -> bool:
    return monkey.gui.window.dialogs.is_open and bool(monkey.usable(*_CLICKED))


def _has_result(monkey: Monkey) -> bool:
    return monkey.gui.session.result is not None and not monkey.gui.window.dialogs.is_open


@dataclass(frozen=True)
class Action:
    """Something to do, how often, and when: what is there to be used is what a user would do something with."""

    weight: int
    act: Callable[[Monkey, random.Random], str]
    is_possible: Callable[[Monkey], bool] = lambda monkey: True


_ACTIONS = {
    "match": Action(8, _match, _labelled("Match")),
    "pause": Action(4, _press("Pause"), _labelled("Pause")),
    "resume": Action(6, _press("Resume"), _labelled("Resume")),
    "cancel": Action(4, _press("Cancel"), _labelled("Cancel")),
    "wait": Action(6, _wait),
    "key": Action(8, _key),
    "slide": Action(7, _slide, _there("slider")),
    "type": Action(7, _type, _there("box")),
    "choose": Action(7, _choose, _there("combo")),
    "click": Action(8, _click, _there(*_CLICKED)),
    "menu": Action(4, _menu, _there("menu")),
    "tab": Action(4, _tab),
    "pick": Action(5, _pick),
    "wheel": Action(2, _wheel),
    "open": Action(5, _open),
    "answer": Action(20, _answer, _asked),
    "export": Action(2, _export, _has_result),
}


def _within(widget: Widget) -> str:
    return widget.section.split("/")[-1] if widget.section else ""


def _files(folder: Path) -> list[Path]:
    """Files to open: good ones, and broken ones."""
    chance = random.Random(0)
    sphere, egg = icosphere(1), ellipsoid(2, 1.0, 0.8, 0.6)
    corners = np.array([[x, y, 0.1 * x * y] for x in range(5) for y in range(5)], dtype=float)
    quads = [5 * x + y for x in range(4) for y in range(4)]
    patch = np.array([f for q in quads for f in ((q, q + 5, q + 1), (q + 1, q + 5, q + 6))])
    good = [folder / name for name in ("sphere.off", "egg.off", "patch.off", "result.npz", "project.abfm")]
    surfaces = [(sphere.vertices, sphere.faces), (egg.vertices, egg.faces), (corners, patch)]
    for path, (vertices, faces) in zip(good[:3], surfaces, strict=True):
        path.write_text(off_text(vertices, faces))
    f, g = (abfm.function(sphere, f"gaussian:vertex={vertex},width=0.3") for vertex in (1, 8))
    match = abfm.match(sphere, f, g, abfm.Parameters(iterations=5))
    match.save(good[3])
    save_project(good[4], Document(sphere, "sphere.off", time=0.5), {})
    bad = []
    for path in good:
        content = path.read_bytes()
        flipped = bytearray(content)
        for place in (chance.randrange(len(content)) for _ in range(20)):
            flipped[place] ^= 1 << chance.randrange(8)
        for word, changed in (("cut", content[: len(content) // 2]), ("flipped", bytes(flipped)), ("empty", b"")):
            bad.append(path.with_stem(f"{path.stem}-{word}"))
            bad[-1].write_bytes(changed)
    two = np.vstack([sphere.vertices, sphere.vertices + 5]), np.vstack([sphere.faces, sphere.faces + 42])
    bad += [folder / "two.off", folder / "nothing.off", folder / "text.txt", folder / "folder.off"]
    bad[-4].write_text(off_text(*two))
    bad[-2].write_text("a text")
    bad[-1].mkdir()
    return [*good, *good, *good, *bad]


def counts() -> dict[str, float]:
    """What the process has at present: threads, children, and megabytes that are resident."""
    task = Path(f"/proc/{os.getpid()}/task")
    children = {child for thread in task.iterdir() for child in (thread / "children").read_text().split()}
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    megabytes = round(pages * resource.getpagesize() / 2**20, 1)
    return {"threads": threading.active_count(), "children": len(children), "megabytes": megabytes}


@dataclass
class Endurance:
    """What the window has after its first five minutes, and what it has at the end: medians of some sequences."""

    begun: float
    latest: deque[dict[str, float]] = field(default_factory=lambda: deque(maxlen=20))
    early: dict[str, float] | None = None

    def add(self, now: dict[str, float]) -> None:
        """What there is after one more sequence."""
        self.latest.append(now)
        if self.early is None and time.monotonic() - self.begun > _EARLY:
            self.early = self._median()

    def _median(self) -> dict[str, float]:
        return {name: median(each[name] for each in self.latest) for name in self.latest[0]}

    def end(self) -> bool:
        """Tell of both, and whether what there is at the end is not more by over a tenth."""
        if self.early is None:
            return True
        late = self._median()
        print(f"# after {_EARLY / 60:g} minutes: {self.early}; at the end: {late}", file=sys.stderr)
        return all(late[name] <= _MOST_GROWTH * self.early[name] for name in late)


def main() -> int:
    """The program; its exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0, help="of the first sequence")
    parser.add_argument("--count", type=int, default=1, help="of sequences, each with the next seed")
    parser.add_argument("--minutes", type=float, default=0.0, help="so long at least, with further seeds")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="after which no sequence begins")
    parser.add_argument("--apart", action="store_true", help="match and evaluate in processes")
    asked = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (_MOST_MEMORY, _MOST_MEMORY))
    began, seed = time.monotonic(), asked.seed
    endurance = Endurance(began)
    with Monkey(asked.apart) as monkey:
        while seed < asked.seed + asked.count or time.monotonic() - began < 60 * asked.minutes:
            if time.monotonic() - began > asked.seconds:
                break
            trial = monkey.sequence(seed)
            print(trial.to_line(), flush=True)
            endurance.add(counts())
            seed += 1
            if (seed - asked.seed) % 50 == 0:
                print(f"# {seed - asked.seed} sequences, {time.monotonic() - began:.0f} s: {counts()}", file=sys.stderr)
        return 0 if endurance.end() else 1


if __name__ == "__main__":
    sys.exit(main())
