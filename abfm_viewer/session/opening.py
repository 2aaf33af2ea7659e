"""Opening and saving files: meshes, projects and results, told apart by their suffix."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from abfm import AbfmError, MeshError, TriangleMesh, load_mesh
from abfm.mesh.files import READERS
from abfm.types import FloatArray
from abfm_viewer.computing.background import one_line
from abfm_viewer.computing.evaluation import Functions
from abfm_viewer.document.document import Channel, Document, Run
from abfm_viewer.session.session import Session

if TYPE_CHECKING:
    from abfm import Match
    from abfm_viewer.files.state_folder import StateFolder

MESHES = tuple(READERS)
PROJECT, RESULT = ".abfm", ".npz"
Ask = Callable[[str, str, Mapping[str, Callable[[], None] | None]], None]


@dataclass
class _Writing:
    """A file that is being written, and what to do when it is."""

    future: Future[None]
    document: Document
    path: Path
    then: list[Callable[[], None]]


def open_session(path: Path, largest_component: bool = False) -> Session:
    """A session that begins with a file, read now.

    Raises
    ------
    AbfmError
        If it cannot be read.
    """
    if not _is_document(path):
        return Session(load_mesh(path, largest_component=largest_component), path.name)
    document, known = read_document(path)
    session = Session(document.mesh, document.name)
    session.restore(document, known, path.absolute() if _is_project(path) else None)
    session.reset_history()
    return session


def read_document(path: Path) -> tuple[Document, dict[str, FloatArray]]:
    """The document of a project or a result, and the values of its functions from files.

    Raises
    ------
    AbfmError
        If it cannot be read.
    """
    if _is_project(path):
        from abfm_viewer.files.project import load_project

        return load_project(path)
    from abfm import load_match

    return document_of_result(load_match(path), path)


def _is_project(path: Path) -> bool:
    return path.name.lower().endswith(PROJECT)


def _is_document(path: Path) -> bool:
    return path.name.lower().endswith((PROJECT, RESULT))


class Documents:
    """Opens and saves a session's files in the background.

    Parameters
    ----------
    session : Session
    state : StateFolder
        Where recent files are kept.
    ask : callable
        Puts a question to the user: title, text, and the answers with what they do.
    """

    def __init__(self, session: Session, state: StateFolder | None, ask: Ask) -> None:
        self._session = session
        self._state = state
        self._ask = ask
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="save")
        self._writing: list[_Writing] = []

    @property
    def saving(self) -> bool:
        """Whether a file is being written."""
        return bool(self._writing)

    def open(self, path: Path) -> None:
        """Open a file in the background; what is open now stays in the history."""
        path = path.expanduser().absolute()
        if not path.name.lower().endswith((*MESHES, PROJECT, RESULT)):
            known = ", ".join((*MESHES, PROJECT, RESULT))
            self._session.say(f"{path.name} cannot be opened: expected a file that ends in {known}", is_error=True)
            return
        read = self._read_document if _is_document(path) else self._read_mesh
        self._session.load(f"opening {path.name}", partial(read, path))

    def open_first(self, paths: list[Path]) -> None:
        """Open the first of several files that were dropped on the window."""
        self.open(paths[0])
        if len(paths) > 1:
            self._session.say(f"opening {paths[0].name}, the first of {len(paths)} files ...")

    def open_figure(self, figure: int) -> None:
        """Open a figure of the paper in the background, ready to match."""
        self._session.load(f"setting up figure {figure}", partial(self._read_figure, figure))

    def save(self, path: Path, then: Callable[[], None] | None = None) -> None:
        """Write the project in the background, and do something when it is written."""
        document = self._session.document
        self._session.say(f"saving {path.name} ...")
        future = self._writer.submit(write_project, path, document, self._session.functions)
        self._writing.append(_Writing(future, document, path, [then] if then else []))

    def when_saved(self, then: Callable[[], None]) -> None:
        """Do something when the file that is being written is."""
        self._writing[-1].then.append(then)

    def update(self) -> None:
        """Take in which files were written: call once per frame."""
        while self._writing and self._writing[0].future.done():
            done = self._writing.pop(0)
            error = done.future.exception()
            if error is not None:
                self._session.say(f"not saved: {one_line(error)}", is_error=True)
                continue
            self._session.mark_saved(done.document, done.path)
            self._remember(done.path)
            for then in done.then:
                then()

    def recent(self) -> list[Path]:
        """Files that were opened or saved, the latest first."""
        return self._state.recent() if self._state else []

    def forget_recent(self) -> None:
        """Forget them."""
        if self._state:
            self._state.clear_recent()

    def _remember(self, path: Path) -> None:
        if self._state:
            self._state.add_recent(path)

    def close(self) -> None:
        """Finish writing."""
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
        text = f"{path.name} has several components, and one is needed: {' '.join(largest.messages)}"
        answers = {"Open the largest": partial(self._show_mesh, path, largest), "Do not open": None}
        return partial(self._ask, "Open the largest component?", text, answers)

    def _show_mesh(self, path: Path, mesh: TriangleMesh) -> None:
        self._show(path, partial(self._session.set_mesh, mesh, path.name), " ".join(mesh.messages))

    def _read_document(self, path: Path) -> Callable[[], None]:
        document, known = read_document(path)

        def show() -> None:
            ours = self._session.view
            if _is_project(path):  # it looks as it was saved, at the size that the user needs on this screen
                view, place = replace(document.view, ui_scale=ours.ui_scale), path
            else:
                view, place = replace(ours, camera=None, front=None), None
            self._session.restore(replace(document, view=view), known, place)

        return partial(self._show, path, show)

    def _read_figure(self, figure: int) -> Callable[[], None]:
        from abfm_viewer.document.presets import figure_document

        document, known = figure_document(figure, self._session.view)
        ready = "press Play, its field is given" if document.result else "press Match"

        def show() -> None:
            self._session.restore(document, known, None)
            self._session.say(f"figure {figure} is ready: {ready}")

        return show

    def _show(self, path: Path, show: Callable[[], None], messages: str = "") -> None:
        left, unsaved = self._session.document.name, self._session.unsaved
        show()
        self._remember(path)
        back = f"Undo returns to {left}, which was not saved." if unsaved else ""
        self._session.say(f"opened {path.name}. {messages} {back}")


def write_project(path: Path, document: Document, functions: Functions) -> None:
    """Write a project with the values of functions that came from other files.

    Raises
    ------
    AbfmError
        If it cannot be written.
    """
    from abfm_viewer.files.project import save_project

    save_project(path, document, known_values(document, functions))


def known_values(document: Document, functions: Functions) -> dict[str, FloatArray]:
    """Values (V,) of the document's functions from files, so that a project does not need these files."""
    from abfm_viewer.files.project_checks import terms_from_files

    specs = [spec for channel in document.channels for spec in (channel.source, channel.target)]
    known = {}
    for term in {term for spec in filter(None, [*specs, document.mask]) for term in terms_from_files(spec)}:
        with suppress(AbfmError):  # what cannot be evaluated now has no values to keep
            known[term] = functions.evaluate(term)
    return known


def document_of_result(match: Match, path: Path) -> tuple[Document, dict[str, FloatArray]]:
    """A document that shows a result at tau, and the values (V,) of its functions, whose specs name the result's file.

    The run is that which led to the result.
    """
    from abfm.functions.values_file import ValuesFile

    known: dict[str, FloatArray] = {}

    def spec(column: str, values: FloatArray) -> str:
        text = str(ValuesFile(path=str(path.absolute()), column=column))
        known[text] = np.array(values)
        return text

    document = Document(
        mesh=match.mesh,
        name=path.name,
        channels=tuple(
            Channel(spec(f"source {i}", match.source[:, i]), spec(f"target {i}", match.target[:, i]), float(weight))
            for i, weight in enumerate(match.weights)
        ),
        parameters=match.parameters,
        mask="" if match.mask is None else spec("mask", match.mask),
        result=match,
        runs=(Run(match.energy_history, match.stages, (), match.mismatch, path.name),),
        time=match.parameters.tau,
    )
    return document, known
