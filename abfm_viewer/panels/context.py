"""What panels, menus and keys draw with and act on."""

from dataclasses import dataclass

from abfm_viewer.dialogs import Dialogs
from abfm_viewer.session.exporter import Exporter
from abfm_viewer.session.session import Session
from abfm_viewer.session.session_files import MESHES, SessionFiles
from abfm_viewer.shown.shown import Shown
from abfm_viewer.widgets.toolkit import Ui


@dataclass(frozen=True)
class Context:
    ui: Ui
    session: Session
    shown: Shown
    exporter: Exporter
    files: SessionFiles
    dialogs: Dialogs

    def open_mesh(self) -> None:
        self.dialogs.open("Open a mesh", MESHES, self.files.open)
