"""Opening and saving a session's files in the background."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

from abfm import MeshError, TriangleMesh, load_mesh
from abfm.assets import asset_path
from abfm.types import FloatArray
from abfm_viewer.computing.background import error_line
from abfm_viewer.document.document import Document, Identity, View
from abfm_viewer.document.samples import MESHES as MESH_SAMPLES
from abfm_viewer.document.wording import capital
from abfm_viewer.files.origin import Origin
from abfm_viewer.files.project import save_project
from abfm_viewer.session.functions import known_values
from abfm_viewer.session.loading import OPENING, Load
from abfm_viewer.session.opening import (
    MESHES,
    PROJECT,
    RESULT,
    is_project,
    read_document,
)
from abfm_viewer.session.session import Session

if TYPE_CHECKING:
    from abfm_viewer.files.state_folder import StateFolder

LARGEST, OTHER_MESH, OTHER_NAME = "Open the largest component", "Open another mesh...", "Save as..."
"""Labels of what can be done about a file."""
SAVING = "saving"
"""What cards are about."""
Make = Callable[[View], tuple[Document, dict[str, FloatArray]]]
"""Makes a document, drawn in a view's theme, and the values of functions that no text describes."""
Ask = Callable[[str, str, Mapping[str, Callable[[], None] | None]], None]


@dataclass(frozen=True, eq=False)
class Waiting:
    """Something to be done when a run has ended; `what` is such as "opening camel.off"."""

    what: str
    do: Callable[[], None]
    started: float = field(default_factory=time.perf_counter, init=False)

    @property
    def elapsed(self) -> float:
        """Seconds since it waits."""
        return time.perf_counter() - self.started


@dataclass
class _Writing:
    future: Future[Origin]
    document: Document
    path: Path
    left: Document | None
    then: list[Callable[[], None]]


class SessionFiles:
    """Opens and saves a session's files, and keeps recent ones in `state`.

    `ask` puts a question to the user: title, text, and the answers with what they do. `ways_out`
    are what the window offers where a file cannot be read or written, by their labels `OTHER_MESH`
    and `OTHER_NAME`.
    """

    def __init__(self, session: Session, state: StateFolder | None, ask: Ask) -> None:
        self._session = session
        self._state = state
        self._ask = ask
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="save")
        self._writing: list[_Writing] = []
        self._samples: WeakKeyDictionary[Identity, str] = WeakKeyDictionary()
        self.waiting: Waiting | None = None  # for the end of a run
        self.ways_out: dict[str, Callable[[], None]] = {}

    @property
    def sample(self) -> str:
        """Return which sample the document is, by its name in the menu; empty if none."""
        document = self._session.document
        name = document.name if document.name in MESH_SAMPLES else ""
        return self._samples.get(document.identity, name)

    @property
    def saving(self) -> bool:
        return bool(self._writing)

    def open(self, path: Path) -> None:
        """Open a file in the background; what is open now stays in the history."""
        path = path.expanduser().absolute()
        name, known = path.name.lower(), (*MESHES, PROJECT, RESULT)
        if name.endswith(known):
            read = self._read_document if name.endswith((PROJECT, RESULT)) else self._read_mesh
            remedies = self._offered(OTHER_MESH, partial(self.open, path))
            source = Origin.of(path)  # as it is now
            what = f"opening {path.name}"
            self.load(Load(what, partial(read, path), remedies=remedies, source=source))
        else:
            text = f"{path.name} cannot be opened: expected a file that ends in {', '.join(known)}"
            self._session.notices.say(text, True, OPENING, self._offered(OTHER_MESH))

    def open_first(self, paths: list[Path]) -> None:
        """Open the first of several files that were dropped on the window."""
        self.open(paths[0])
        if len(paths) > 1:
            text = f"opening {paths[0].name}, the first of {len(paths)} files ..."
            self._session.notices.say(text)

    def open_made(self, name: str, make: Make) -> None:
        """Open a sample that is made in the background, ready to match."""
        remedies = self._offered("", partial(self.open_made, name, make))
        read = partial(self._read_made, name, make)
        self.load(Load(f"setting up {name}", read, remedies=remedies))

    def load(self, load: Load) -> None:
        """Read something that takes the document's place, when no run is under way or may end."""
        self.when_free(load.what, partial(self._session.loading.begin, load))

    def when_free(self, what: str, do: Callable[[], None]) -> None:
        """Do something that takes the document's place; a run is ended only if the user says so."""
        if not self._session.solver.running:
            do()
            return
        text = (
            f"{self._session.document.name} is being matched. {capital(what)} ends the run; the "
            "best field so far stays, and Undo returns to it."
        )
        answers = {"End the run": partial(self.end_run, what, do), "Go back": None}
        self._ask("End the run?", text, answers)

    def end_run(self, what: str, then: Callable[[], None]) -> None:
        """End the run that is under way, and do something when its best field is there."""
        self._session.solver.cancel()
        self.waiting = Waiting(what, then)

    def stop_waiting(self) -> None:
        """Do nothing when the run has ended; it ends all the same, with its best field."""
        self.waiting = None

    def save(
        self, path: Path, then: Callable[[], None] | None = None, document: Document | None = None
    ) -> None:
        """Write the project, or another document, in the background; then do something."""
        document = document or self._session.document
        functions = self._session.functions_of(document)
        left = self._session.saves.left(document)
        self._session.notices.say(f"saving {path.name} ...")

        def write() -> Origin:
            save_project(path, document, known_values(document, functions))
            return Origin.of(path)

        future = self._writer.submit(write)
        self._writing.append(_Writing(future, document, path, left, [then] if then else []))

    def when_saved(self, then: Callable[[], None]) -> None:
        """Do something when the file that is being written is."""
        self._writing[-1].then.append(then)

    def update(self) -> None:
        """Take in which files were written, and that a run has ended: call once per frame."""
        if self.waiting is not None and not self._session.solver.running:
            waiting, self.waiting = self.waiting, None
            waiting.do()
        while self._writing and self._writing[0].future.done():
            done = self._writing.pop(0)
            error = done.future.exception()
            if error is not None:
                again = partial(self.save, done.path, _all(done.then), done.document)
                remedies = self._offered(OTHER_NAME, again)
                self._session.notices.say(f"not saved: {error_line(error)}", True, SAVING, remedies)
                continue
            self._session.notices.mend(SAVING)
            self._session.saves.mark(done.document, done.future.result(), done.left)
            self._session.notices.say(f"saved {done.path}")
            self._remember(done.path)
            for then in done.then:
                then()

    def recent(self) -> list[Path]:
        """Files that were opened or saved, the latest first."""
        return self._state.recent() if self._state else []

    def forget_recent(self) -> None:
        if self._state:
            self._state.clear_recent()

    def _remember(self, path: Path) -> None:
        if self._state:
            self._state.add_recent(path)

    def close(self) -> None:
        self._writer.shutdown()

    def _read_mesh(self, path: Path) -> Callable[[], None]:
        try:
            return partial(self._show_mesh, path, load_mesh(path))
        except MeshError as error:
            reason = str(error)
        try:
            largest = load_mesh(path, largest_component=True)
        except MeshError:
            raise MeshError(reason) from None
        size = f"{len(largest.vertices):,} vertices and {len(largest.faces):,} faces"
        text = f"{path.name} has several components, and one is needed; the largest has {size}"
        show: Callable[[], None] = partial(
            self.when_free, f"opening {path.name}", partial(self._show_mesh, path, largest)
        )
        remedies = {LARGEST: show} | self._offered(OTHER_MESH)
        return partial(self._session.notices.say, text, True, OPENING, remedies)

    def _show_mesh(self, path: Path, mesh: TriangleMesh) -> None:
        self._show(path, partial(self._session.set_mesh, mesh, path.name), mesh.messages)
        is_sample = path in map(asset_path, MESH_SAMPLES)
        self._samples[self._session.document.identity] = path.name if is_sample else ""

    def _read_document(self, path: Path) -> Callable[[], None]:
        origin = Origin.of(path) if is_project(path) else None
        document, known = read_document(path)

        def restore() -> None:
            view = replace(self._session.view, look=None, large="")
            if origin:  # with a view of its own, in the size that the user needs on this screen
                view = replace(document.view, ui_scale=view.ui_scale)
            self._session.restore(replace(document, view=view), known, origin)

        return partial(self._show, path, restore)

    def _read_made(self, name: str, make: Make) -> Callable[[], None]:
        document, known = make(self._session.view)
        ready = "press Play, its field is given" if document.result else "press Match"

        def show() -> None:
            self._session.restore(document, known, None)
            self._samples[document.identity] = capital(name)
            self._session.notices.say(f"{name} is ready: {ready}")

        return show

    def _offered(
        self, label: str, again: Callable[[], None] | None = None
    ) -> dict[str, Callable[[], None]]:
        """Trying again, and a way out that the window has."""
        first = {"Try again": again} if again else {}
        return first | ({label: self.ways_out[label]} if label in self.ways_out else {})

    def _show(self, path: Path, show: Callable[[], None], messages: tuple[str, ...] = ()) -> None:
        left, unsaved = self._session.document.name, self._session.saves.unsaved
        show()
        self._session.notices.mend(OPENING)
        self._remember(path)
        back = f" Undo returns to {left}, which was not saved." if unsaved else ""
        self._session.notices.say(f"{'; '.join([f'opened {path.name}', *messages])}.{back}")


def _all(actions: list[Callable[[], None]]) -> Callable[[], None]:
    """One after the other."""

    def do() -> None:
        for action in actions:
            action()

    return do
