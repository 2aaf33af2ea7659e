"""Context of panels, menus and keys: the session, widgets, dialogs and files."""

from collections.abc import Callable
from typing import TypeVar

from abfm.reading import FRAMES_ENDINGS
from abfm_viewer.dialogs import Dialogs
from abfm_viewer.document.document import Document
from abfm_viewer.files.contents import MESHES
from abfm_viewer.files.preferences import PreferenceFile, with_stored
from abfm_viewer.files.result_tables import NAMES
from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.scene.textures import Textures
from abfm_viewer.session import session_files
from abfm_viewer.session.saving.export_settings import ExportSettings
from abfm_viewer.session.saving.exporter import Exporter
from abfm_viewer.session.session import Session
from abfm_viewer.shown.shown import Shown
from abfm_viewer.widgets.toolkit import Ui

Kind = TypeVar("Kind", bound=Document)


class Context:
    """A session with the widgets, dialogs, exports and files of its window.

    Recent files and preferences are stored in the folder ``state``.
    """

    def __init__(self, session: Session, state: StateFolder | None) -> None:
        self.session, self.shown = session, Shown(session)
        self.preferences = PreferenceFile(state)
        recent, change = self.preferences.now.folders, self.preferences.change
        self.ui, self.dialogs = Ui(), Dialogs(recent, lambda found: change(folders=found))
        self.textures = Textures()
        # lists copies of unsaved work of earlier launches; None if there are none
        self.list_copies: Callable[[], None] | None = None
        self.exporter = Exporter(session.notices.show)
        self.exporter.settings = with_stored(ExportSettings(), self.preferences.now.export)
        self.files = session_files.SessionFiles(session, state, self.dialogs.question)
        actions = self.files.file_actions
        actions[session_files.OTHER_MESH] = self.open_mesh
        actions[session_files.OTHER_SECOND] = self.open_second
        actions[session_files.OTHER_FRAMES] = self.open_frames
        actions[session_files.OTHER_TABLE] = self.open_table

    def document(self, kind: type[Kind]) -> Kind:
        """Return the current document, which must be of the given kind."""
        document = self.session.document
        assert isinstance(document, kind)
        return document

    def open_mesh(self) -> None:
        self.dialogs.open("Open a mesh", MESHES, self.files.open, "meshes")

    def open_table(self) -> None:
        self.dialogs.open("Open a batch or population", NAMES, self.files.open, "results")

    def open_second(self) -> None:
        open_second = self.files.open_second
        self.dialogs.open("Open a second surface", MESHES, open_second, "meshes")

    def open_frames(self) -> None:
        self.dialogs.open("Open frames", FRAMES_ENDINGS, self.files.open_frames)
