"""A monkey at the window: random sequences of what a user can do, each given by its seed.

``python -m tests.attack.monkey --seed S --count N`` prints a line for each (see
`tests.attack.trial`). A sequence ends by waiting until nothing is computed any more, and by undoing
everything, which must lead back to where it began. The window lives on from one sequence to the
next, and its unsaved work is saved in between, as somebody would who works all day. ``--apart``
matches and evaluates in processes, as a real window does on large meshes. A run of more than five
minutes tells at its end what the window has then and had after those, and ends with 1 if that is
more by a tenth.
"""

from __future__ import annotations

import argparse
import io
import random
import re
import resource
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

from abfm_viewer.automation import Driver
from abfm_viewer.computing import background, evaluation
from abfm_viewer.document.document import Document
from abfm_viewer.errors import DriverError
from abfm_viewer.widgets.widget_record import Widget
from tests.attack.endurance import Endurance, counts
from tests.attack.monkey_actions import ACTIONS, LEFT_ALONE
from tests.attack.monkey_files import monkey_files
from tests.attack.trial import Trial
from tests.shapes import ellipsoid

_LENGTH = (5, 25)  # actions of a sequence, at least and at most
# frames of 5 ms, and as long as they take, in which everything must come to its end
_PATIENCE = 3000
_LONGEST_LINE = 1000
_MOST_MEMORY = 6 << 30  # bytes of address space
_BUG = re.compile(
    r"\b(?:Type|Key|Index|Attribute|Value|Runtime|Assertion|Name|Lookup"
    r"|Arithmetic|Recursion)Error: "
)
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

    def __init__(self, apart: bool) -> None:
        self._closing = ExitStack()
        self._apart = apart
        self.found = Found()

    def __enter__(self) -> Monkey:
        self.folder = Path(
            self._closing.enter_context(tempfile.TemporaryDirectory(prefix="abfm-monkey-"))
        )
        mesh = ellipsoid(2, 1.0, 0.7, 0.55)
        if self._apart:
            before, evaluation.OWN_PROCESS_FROM = evaluation.OWN_PROCESS_FROM, 100
            self._closing.callback(setattr, evaluation, "OWN_PROCESS_FROM", before)
        self.files = monkey_files(self.folder)
        self._closing.enter_context(self._watched())
        driver = Driver(mesh, backend="openGL_mock", size=(1100, 800))
        self.gui = self._closing.enter_context(driver)
        self.gui.window.dialogs.folder = self.folder
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
        for _ in range(chance.randint(*_LENGTH)):
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
        possible = {name: each for name, each in ACTIONS.items() if each.is_possible(self)}
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
            self.found.fault(
                f"{owner}: {type(error).__name__}: {error} at "
                f"{Path(where.filename).name}:{where.lineno}"
            )
        self.found.done.append(done)
        for part, error_line in self.gui.errors.items():
            self.found.fault(f"{part}: {error_line}")

    def usable(self, *kinds: str, label: str = "") -> list[Widget]:
        """Widgets of these kinds that were drawn last and are not grey, or those of a label."""
        drawn = [
            w
            for w in self.gui.window.ui.widgets
            if w.enabled and w.kind in kinds and w.label not in LEFT_ALONE
        ]
        return [w for w in drawn if not label or w.label == label]

    def widget(self, chance: random.Random, *kinds: str, label: str = "") -> Widget:
        self.gui.frames(1)
        if not (usable := self.usable(*kinds, label=label)):
            raise DriverError("there is no such widget any more")
        return chance.choice(usable)

    # How it ends

    def rest(self) -> None:
        """Do nothing until threads that wait for work have ended."""
        end = time.monotonic() + 1.5 * background._IDLE
        while time.monotonic() < end:
            self.gui.frames(1)
            time.sleep(0.05)

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
            if quiet > 2:
                break
            time.sleep(0.005)
        else:
            self.found.fault(f"no end of: {self._at_work()}")
        for part, error in gui.errors.items():
            self.found.fault(f"{part}: {error}")
        for entry in session.notices.log:
            if entry.kind == "error" and (
                _BUG.search(entry.text) or len(entry.text) > _LONGEST_LINE
            ):
                self.found.fault(f"told: {entry.text[:300]}")
        session.notices.log.clear()  # type: ignore[attr-defined]
        for card in session.notices.cards:
            session.notices.dismiss(card)

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
        while session.editor.history.undo_label:
            label, moves = session.editor.history.undo_label, session.editor.history.moves
            session.undo()
            self.gui.frames(1)
            if session.editor.history.moves == moves:
                self.found.fault(f"undo of {label!r} did nothing: {session.notices.latest.text}")
                return
        if differing := differences(start, session.document):
            self.found.fault(f"undo left other {', '.join(differing)}")

    def _save_all(self) -> None:
        """As one who closes the window: every document that would be lost goes into a file."""
        window, session = self.gui.window, self.gui.session
        # where a result was undone, what is there now differs from the file with the result
        for _ in range(2):
            for number, document in enumerate(session.saves.unsaved_documents):
                window.files.save(self.folder / f"left-{number}.abfm", document=document)
            self._settle()
        if session.saves.unsaved_documents:
            names = ", ".join(document.name for document in session.saves.unsaved_documents)
            self.found.fault(f"not saved: {names}: {session.notices.latest.text}")

    @contextmanager
    def _watched(self) -> Iterator[None]:
        """Exceptions that the app prints, as it lives on, and those that end a thread, are
        faults.
        """

        def printed(*_: object, **__: object) -> None:
            text = io.StringIO()
            traceback.print_exception(*sys.exc_info(), file=text)
            sys.stderr.write(text.getvalue())
            self.found.fault(f"printed: {text.getvalue()[-400:]}")

        def ended(raised: threading.ExceptHookArgs) -> None:
            self.found.fault(
                f"thread {raised.thread and raised.thread.name}: {raised.exc_type.__name__}: "
                f"{raised.exc_value}"
            )
            hook(raised)

        print_exc, hook = traceback.print_exc, threading.excepthook
        traceback.print_exc, threading.excepthook = printed, ended
        try:
            yield
        finally:
            traceback.print_exc, threading.excepthook = print_exc, hook


def differences(one: Document, other: Document) -> list[str]:
    """What two documents differ in; how surfaces are turned and the time that plays are not
    steps of undo.
    """
    seen = {"look": None, "large": ""}
    one, other = (replace(each, view=replace(each.view, **seen), time=0.0) for each in (one, other))
    names = [each.name for each in fields(Document)]
    return [name for name in names if getattr(one, name) != getattr(other, name)]


def main() -> int:
    """The program; its exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0, help="of the first sequence")
    parser.add_argument(
        "--count", type=int, default=1, help="of sequences, each with the next seed"
    )
    parser.add_argument(
        "--minutes", type=float, default=0.0, help="so long at least, with further seeds"
    )
    parser.add_argument(
        "--seconds", type=float, default=float("inf"), help="after which no sequence begins"
    )
    parser.add_argument("--apart", action="store_true", help="match and evaluate in processes")
    asked = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (_MOST_MEMORY, _MOST_MEMORY))
    began, seed = time.monotonic(), asked.seed
    with Monkey(asked.apart) as monkey:
        endurance = Endurance(began, monkey.rest)
        while seed < asked.seed + asked.count or time.monotonic() - began < 60 * asked.minutes:
            if time.monotonic() - began > asked.seconds:
                break
            trial = monkey.sequence(seed)
            print(trial.to_line(), flush=True)
            endurance.add()
            seed += 1
            if (seed - asked.seed) % 50 == 0:
                print(
                    f"# {seed - asked.seed} sequences, {time.monotonic() - began:.0f} s: "
                    f"{counts()}",
                    file=sys.stderr,
                )
        return 0 if endurance.end() else 1


if __name__ == "__main__":
    sys.exit(main())
