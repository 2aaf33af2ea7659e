"""Opening and saving of the files of a session in the background, with questions to the user."""

import os
import tempfile
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import abfm
from abfm import AbfmError, MeshError, TriangleMesh, load_mesh
from abfm.assets import asset_path
from abfm.errors import SeveralArraysError, brief, one_line
from abfm.mesh.options import DEFAULT_OPTIONS, MeshOptions
from abfm.pages.creases import drawn_mesh
from abfm.types import FloatArray
from abfm.wording import capital
from abfm_viewer.appearance.samples import MESHES as MESH_SAMPLES
from abfm_viewer.computing.background import error_line
from abfm_viewer.document.document import Document, Identity, Surface, View
from abfm_viewer.document.frame_sequence import FrameSequence
from abfm_viewer.document.kinds import SequenceDocument
from abfm_viewer.document.label_map import LabelMap
from abfm_viewer.files.contents import (
    FRAME_ENDINGS,
    MESHES,
    PROJECT,
    RESULT,
    Contents,
    contents_of,
    is_named_as_frames,
)
from abfm_viewer.files.documents import Opened, read_document
from abfm_viewer.files.project import Origin, save_project
from abfm_viewer.files.result_tables import place_of
from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.session.functions import known_values, with_values
from abfm_viewer.session.loading import OPENING, Load
from abfm_viewer.session.result_tables import FoundTable, Tables, find_table
from abfm_viewer.session.sequence_files import (
    circular_sequence,
    document_of_frames,
    document_of_pair,
    read_frame_sequence,
)
from abfm_viewer.session.session import Session

LABELS = (
    *(".label.gii", ".gii", ".gii.gz", ".annot", ".dlabel.nii"),
    *(".npy", ".csv", ".tsv", ".txt", ".mat", ".mgh", ".mgz"),  # tables and arrays of integers
)
OTHER_MESH = "Open another mesh..."
OTHER_NAME = "Save as..."
OTHER_SECOND = "Open another second surface..."
OTHER_FRAMES = "Open other frames..."
OTHER_TABLE = "Open another table..."
"""Labels of actions that are offered if a file cannot be read or written."""
SAVING_TOPIC = "saving"  # topic of cards about saving
Action = Callable[[], None]
ShowMesh = Callable[[Path, TriangleMesh], None]
OpenQuestion = Callable[..., None]  # parameters as of `Dialogs.question`


def open_session(
    path: Path,
    options: MeshOptions = DEFAULT_OPTIONS,
    second: Path | None = None,
    array: str | None = None,
) -> Session:
    """Return a session with a mesh, project or result, which is read before the function returns.

    ``second`` is the file of a second mesh, to which the first one is registered, or of frames on
    the mesh. If that file has several arrays, ``array`` names the one with the frames. A file that
    cannot be read raises an `AbfmError`.
    """
    contents = contents_of(path)
    if contents is Contents.FRAMES:
        raise AbfmError(
            f"{one_line(path.name)} may contain frames but not their mesh; give the mesh first: "
            f"abfm-viewer MESH {one_line(path.name)}"
        )
    has_frames = second is not None and contents_of(second) in (Contents.FRAMES, Contents.DOCUMENT)
    if array is not None and not has_frames:
        raise AbfmError(
            f"the array {brief(array)} was given without a file of frames; give the file as well"
        )
    if contents is Contents.DOCUMENT:
        if second is not None:
            raise AbfmError(f"{path.name} is not a mesh; give two meshes, or one project or result")
        return session_of(read_document(path), _origin(path.absolute()))
    session = Session(load_mesh(path, **options.changed), path.name)
    if second is None:
        return session
    if has_frames:
        sequence, notes = read_frame_sequence(second, session.surface().mesh, array)
        session.restore(document_of_frames(sequence, session.surface(), session.view), {}, None)
        session.notices.show("; ".join(notes))
    else:
        other = load_mesh(second, **options.changed)
        session.set_surfaces(*session.document.surfaces, Surface(other, second.name))
    session.reset_history()
    return session


def session_of(opened: Opened, origin: Origin | None = None) -> Session:
    document, known = opened
    if origin is None:
        document = replace(document, view=document.view_of_result(document.view))
    session = Session(document.surface().mesh, document.name)
    session.restore(document, known, origin)
    session.reset_history()
    return session


def _absolute(path: Path) -> Path:
    # Path.expanduser raises an error for unknown users
    return Path(os.path.expanduser(path)).absolute()


def find_first(path: Path) -> FoundTable | None:
    """Read a table of results and the document of its worst row; None if there is no table."""
    path = _absolute(path)
    place = place_of(path)
    if path.name.lower().endswith(RESULT) and contents_of(path) is Contents.TABLE:
        place = path
    return None if place is None else find_table(place)


def _origin(path: Path) -> Origin | None:
    return Origin.of(path) if path.name.lower().endswith(PROJECT) else None


class SessionFiles:
    """Opens and saves the files of a session.

    ``state`` stores the list of recent files, unless it is None. ``open_question`` shows a question
    with buttons.
    """

    def __init__(
        self, session: Session, state: StateFolder | None, open_question: OpenQuestion
    ) -> None:
        self._session = session
        self.state = state
        self._open_question = open_question
        # unlike a daemon thread, it finishes writing at the end of the program
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="save")
        # for each file being written: the action at its end, and further actions after that
        self._writing: list[tuple[Future[Origin], Action, list[Action]]] = []
        self._samples: WeakKeyDictionary[Identity, str] = WeakKeyDictionary()
        # files of documents: the mesh alone, or with a second mesh or frames
        self._paths: WeakKeyDictionary[Identity, tuple[Path, ...]] = WeakKeyDictionary()
        # `Editor.action_count` after the first of two files was opened
        self._opened_first = -1
        self.waiting: Load | None = None  # request that waits for the end of the run
        # offered if a file cannot be read or written, by labels such as `OTHER_MESH`
        self.file_actions: dict[str, Action] = {}
        self.tables = Tables(session, self._load)

    @property
    def sample(self) -> str:
        document = self._session.document
        name = document.name if document.name in MESH_SAMPLES else ""
        return self._samples.get(document.identity, name)

    @property
    def saving(self) -> bool:
        return bool(self._writing)

    def open(self, path: Path) -> None:
        """Open a file or folder in the background; Undo returns to the document before it."""
        path = _absolute(path)
        place = place_of(path)
        if place is None and is_named_as_frames(path):  # `summary.csv` also ends like frames
            self.open_frames(path)
            return
        known = (*MESHES, PROJECT, RESULT)
        if place is None and not path.name.lower().endswith(known):
            listed = ", ".join(
                each for each in (*known, *FRAME_ENDINGS) if not each.endswith(".gz")
            )
            text = f"{path.name} cannot be opened; expected a file that ends in {listed}"
            self._session.notices.show(text, True, OPENING, self._action(OTHER_MESH))
            return
        source, path = Origin.of(path), place or path
        read, other = partial(self._read, path), OTHER_TABLE if place else OTHER_MESH
        self._load(Load(f"opening {path.name}", read, other, source))

    def open_together(self, paths: tuple[Path, ...]) -> None:
        """Open a file, or a mesh with a second mesh or frames."""
        if len(paths) == 1:
            self.open(paths[0])
        else:
            has_frames = contents_of(paths[1]) is not Contents.MESH
            then = self.open_frames if has_frames else self.open_second
            self._open_both(paths[0], paths[1], then)

    def record_paths(self, *paths: Path) -> None:
        """Record the files of the current document, and add them to the recent files."""
        self._paths[self._session.document.identity] = paths
        if self.state:
            self.state.add_recent(*paths)

    def _read(self, path: Path, show_mesh: ShowMesh | None = None) -> Action:
        """Read a file by its contents, and return a function that shows it.

        A mesh is shown by ``show_mesh``, by default as the only surface.
        """
        readers: dict[Contents, Callable[[Path], Action]] = {
            Contents.TABLE: self._read_table,
            Contents.FRAMES: self._read_frames,
            Contents.DOCUMENT: self._read_document,
        }
        read_mesh = partial(self._read_mesh, show_mesh=show_mesh or self._show_mesh)
        return readers.get(contents_of(path), read_mesh)(path)

    def _read_table(self, place: Path) -> Action:
        show_table = self.tables.read(place)

        def show() -> None:
            show_table()
            if self.state:
                self.state.add_recent(place)

        return show

    def open_second(self, path: Path) -> None:
        """Open a mesh in the background as surface B; the current surface is registered to it."""
        path = _absolute(path)
        read, source = partial(self._read, path, self._show_second), (Origin.of(path), "second")
        self._load(Load(f"opening {path.name} as second surface", read, OTHER_SECOND, source))

    def open_frames(self, path: Path, array: str | None = None) -> None:
        """Open frames on the mesh, or on A of two surfaces; ``array`` is one of several arrays."""
        path, mesh = _absolute(path), self._session.surface("source").mesh
        source = Origin.of(path), mesh.digest, array
        read = partial(self._read_frames, path, array)
        self._load(Load(f"opening {path.name}", read, OTHER_FRAMES, source))

    def _read_frames(self, path: Path, array: str | None = None) -> Action:
        session, surface = self._session, self._session.surface("source")
        try:
            sequence, notes = read_frame_sequence(path, surface.mesh, array)
        except SeveralArraysError as error:
            return partial(self._choose_array, path, error.names)

        def show() -> None:
            here = next((one for one in session.document.surfaces if one == surface), surface)
            view = replace(session.view.preferences, viewpoint=session.view.viewpoint)
            shown = document_of_frames(sequence, here, view)
            self._show(path, partial(session.restore, shown, {}, None), notes, adds=True)

        return show

    def _choose_array(self, path: Path, names: tuple[str, ...]) -> None:
        name = one_line(path.name, 60)
        self._session.notices.show(f"{name} has {len(names)} arrays; choose one of them")
        answers: dict[str, Action | None] = {
            one_line(each, 40): partial(self.open_frames, path, each) for each in names
        }
        text = f"{name} has several arrays. Which one contains the frames?"
        self._open_question("Which array?", text, answers | {"Open none": None})

    def set_circular(self, document: SequenceDocument, period: float | None) -> None:
        """Replace phases by cosine and sine of a period; without a period, restore the phases."""
        sequence = document.sequence

        def show(made: FrameSequence) -> None:
            now = self._session.document
            if isinstance(now, SequenceDocument) and now.sequence is sequence:
                change = self._session.editor.change
                change("change circular", sequence=made, result=None, channel=0)

        what = "computing cosine and sine" if period else "restoring phases"
        self._load(Load(what, lambda: partial(show, circular_sequence(sequence, period))))

    def match_frames(self, document: SequenceDocument, first: int, last: int) -> None:
        def make(_: View) -> Opened:
            made, known = document_of_pair(document, first, last)
            self.tables.attach_to(made)
            return made, known

        sequence = document.sequence
        self.open_made(f"{sequence.frame_label(first)} to {sequence.frame_label(last)}", make)

    def _open_both(self, mesh: Path, second: Path, then: Callable[[Path], None]) -> None:
        def show(path: Path, found: TriangleMesh) -> None:
            self._show_mesh(path, found)
            self._opened_first = self._session.editor.action_count
            then(second)

        read, source = partial(self._read, mesh, show), (Origin.of(mesh), second)
        self._load(Load(f"opening {mesh.name} and {second.name}", read, OTHER_MESH, source))

    def open_labels(self, path: Path) -> None:
        """Read labels of the vertices from a file, and show them on the surface of the source."""
        session, mesh = self._session, self._session.surface("source").mesh
        with session.notices.showing_errors():
            # the first column; the window offers no choice of another one
            labels = abfm.functions.read_label_columns(path, mesh).labels(0)
            found = LabelMap.of(path.name, mesh, labels)
            session.editor.change(f"open {path.name}", labels=found)
            session.editor.amend(view=replace(session.view, coloring="labels"))

    def open_dropped(self, paths: list[Path]) -> None:
        """Open dropped files: two meshes as A and B, a mesh and frames, or else the first file."""
        kinds = list(map(contents_of, paths)) if len(paths) == 2 else []
        if sorted(kinds) == [Contents.FRAMES, Contents.MESH]:
            mesh, frames = sorted(paths, key=lambda path: contents_of(path) is Contents.FRAMES)
            self._open_both(_absolute(mesh), frames, self.open_frames)
            return
        if kinds == [Contents.MESH] * 2:
            first, second = map(_absolute, paths)
            self._open_both(first, second, self.open_second)
            return
        self.open(paths[0])
        if len(paths) > 1:
            text = f"opening {paths[0].name}, the first of {len(paths)} files ..."
            self._session.notices.show(text)

    def open_made(self, name: str, make: Callable[[View], Opened]) -> None:
        def show(document: Document, known: dict[str, FloatArray]) -> None:
            self._session.restore(document, known, None)
            self._samples[document.identity] = name if name == document.name else capital(name)
            play = "press Play to see its field"
            advice = play if document.result else f"press {document.match_label}"
            self._session.notices.show(f"{name} is ready; {advice}")

        def read() -> Action:
            return partial(show, *with_values(*make(self._session.view)))

        self._load(Load(f"setting up {name}", read))

    def open_made_table(self, name: str, make: Callable[[Path], Path]) -> None:
        """Open the table that ``make(folder)`` computes, or finds from an earlier call."""
        from importlib.metadata import version  # slow to load

        root = self.state.path if self.state else Path(tempfile.mkdtemp())
        folder = root / "samples" / version("abfm") / "sample"

        def show(show_table: Action) -> None:
            show_table()
            self._samples[self._session.document.identity] = name

        read = self.tables.read
        what = f"setting up {name.lower()}"
        self._load(Load(what, lambda: partial(show, read(make(folder))), takes_long=True))

    def load(self, what: str, read: Callable[[], Action]) -> None:
        """Read in the background, such as "recovering A"; ``read`` returns how to show it."""
        self._load(Load(what, read))

    def _load(self, load: Load) -> None:
        """Start to read a file, after a question if a task is in progress; offer to try again."""
        remedies = {"Try again": partial(self._load, load)} | self._action(load.other)
        begin = partial(self._session.loading.begin, replace(load, remedies=remedies))
        self.when_free(load.what, begin)

    def when_free(self, what: str, do: Action) -> None:
        """Replace the document by an action, after a question if a run or a long load is active.

        ``what`` describes the action in the question.
        """
        now = self._session.loading.now
        if now is not None and now.takes_long:
            self._confirm_cancelling(now, what, do)
            return
        if not self._session.solver.running:
            do()
            return
        text = (
            f"{self._session.document.name} is being matched. {capital(what)} ends the run. The "
            "best field so far is kept, and Undo returns to it."
        )
        answers = {"End the run": partial(self.end_run, what, do), "Go back": None}

        def instead() -> Action | None:
            return None if self._session.solver.running else partial(self._do_after_run, what, do)

        self._open_question("End the run?", text, answers, instead)

    def _confirm_cancelling(self, now: Load, what: str, do: Action) -> None:
        loading = self._session.loading

        def instead() -> Action | None:
            text = f"{what} was not started, because {now.what} has ended meanwhile; try again"
            return None if loading.now is now else partial(self._session.notices.show, text)

        def cancel() -> None:
            loading.cancel()
            self.when_free(what, do)

        text = f"{capital(now.what)} is still in progress. {capital(what)} would cancel it."
        answers = {f"Cancel {now.what}": cancel, "Go back": None}
        self._open_question("Cancel the current task?", text, answers, instead)

    def _do_after_run(self, what: str, do: Action) -> None:
        """Replace the document by an action, after a question if it has unsaved changes."""
        if not self._session.saves.unsaved:
            do()
            return
        text = (
            f"The run of {self._session.document.name} has ended meanwhile, and its result is not "
            f"saved. {capital(what)} replaces it; Undo returns to it."
        )
        self._open_question("Replace the result?", text, {"Replace": do, "Go back": None})

    def end_run(self, what: str, then: Action) -> None:
        self._session.solver.cancel()
        self.waiting = Load(what, lambda: then)

    def stop_waiting(self) -> None:
        self.waiting = None

    def save(
        self, path: Path, then: Action | None = None, document: Document | None = None
    ) -> None:
        """Write the current document, or another, in the background; on success call ``then``."""
        session, notices = self._session, self._session.notices
        document = document or session.document
        functions = session.functions.of_document(document)
        unsaved_state = session.saves.unsaved_state(document)
        actions = [then] if then else []
        notices.show(f"saving {path.name} ...")

        def write() -> Origin:
            save_project(path, document, known_values(document, functions))
            return Origin.of(path)

        future = self._writer.submit(write)

        def perform_actions() -> None:
            for action in actions:
                action()

        def end() -> None:
            if error := future.exception():
                again = {"Try again": partial(self.save, path, perform_actions, document)}
                remedies = again | self._action(OTHER_NAME)
                notices.show(f"not saved: {error_line(error)}", True, SAVING_TOPIC, remedies)
                return
            notices.resolve(SAVING_TOPIC)
            session.saves.record(document, future.result(), unsaved_state)
            notices.show(f"saved {path}")
            if self.state:
                self.state.add_recent(path)
            perform_actions()

        self._writing.append((future, end, actions))

    def when_saved(self, then: Action) -> None:
        self._writing[-1][2].append(then)

    def update(self) -> None:
        """Finish saves, and start requests that waited for a run; called before each drawing."""
        self.tables.update()
        if self.waiting is not None and not self._session.solver.running:
            waiting, self.waiting = self.waiting, None
            waiting.read()()
        while self._writing and self._writing[0][0].done():
            _, end, _ = self._writing.pop(0)
            end()

    def close(self) -> None:
        self.tables.close()
        self._writer.shutdown()

    def _read_mesh(self, path: Path, show_mesh: ShowMesh, **options: Any) -> Action:
        """Read a mesh; return a function that shows it, or offers repairs if it has faults."""
        try:
            mesh = load_mesh(path, **options)
        except MeshError as error:
            if options or not error.remedies:
                raise
            repairs = (f'"{each.button}" keeps {each.keeps}' for each in error.remedies)
            text = f"{path.name}: {error.problem}. {'; '.join(repairs)}"
            what, read = f"opening {path.name}", partial(self._read_mesh, path, show_mesh)
            remedies: dict[str, Action] = {
                each.button: partial(
                    self._load, Load(what, partial(read, **each.options), OTHER_MESH)
                )
                for each in error.remedies
            }
            notice = text, True, OPENING, remedies | self._action(OTHER_MESH)
            return partial(self._session.notices.show, *notice)
        drawn_mesh(mesh)
        _ = mesh.genus, mesh.is_inside_out
        return partial(show_mesh, path, mesh)

    def _show_mesh(self, path: Path, mesh: TriangleMesh) -> None:
        self._show(path, partial(self._session.set_mesh, mesh, path.name), mesh.messages)
        is_sample = path in map(asset_path, MESH_SAMPLES)
        self._samples[self._session.document.identity] = path.name if is_sample else ""

    def _show_second(self, path: Path, mesh: TriangleMesh) -> None:
        first = self._session.surface("source")
        show = partial(self._session.set_surfaces, first, Surface(mesh, path.name))
        notes = f"{first.name} is A, {path.name} is B", *mesh.messages
        self._show(path, show, notes, adds=True)

    def _read_document(self, path: Path) -> Action:
        origin = _origin(path)
        document, known = with_values(*read_document(path))

        def restore() -> None:
            view = document.view  # a project has its own view
            if origin is None:
                view = document.view_of_result(self._session.view.preferences)
            self._session.restore(replace(document, view=view), known, origin)

        load_warning = document.match.load_warning if document.match else ""
        return partial(self._show, path, restore, load_warning=load_warning)

    def _action(self, label: str) -> dict[str, Action]:
        return {label: self.file_actions[label]} if label in self.file_actions else {}

    def _show(
        self,
        path: Path,
        show: Action,
        messages: tuple[str, ...] = (),
        load_warning: str = "",
        adds: bool = False,
    ) -> None:
        """Show a document of a file; with ``adds``, the file is added to the mesh that is open."""
        previous, unsaved = self._session.document.name, self._session.saves.unsaved
        mesh = self._paths.get(self._session.document.identity, ())[:1] if adds else ()
        if any(one.name.lower().endswith((PROJECT, RESULT)) for one in mesh):
            mesh = ()
        is_one_step = adds and self._opened_first == self._session.editor.action_count
        show()
        if is_one_step:
            self._session.editor.join_steps()
        self._session.notices.resolve(OPENING)
        self.record_paths(*mesh, path)
        back = f" Undo returns to {previous}, which was not saved." if unsaved else ""
        self._session.notices.show(f"{'; '.join([f'opened {path.name}', *messages])}.{back}")
        if load_warning:
            text = (
                f"values stored in {path.name} do not match its field and were recomputed: "
                f"{load_warning}"
            )
            self._session.notices.show(text, True, OPENING)
