"""The menu bar."""

from __future__ import annotations

from abfm_viewer.session import Session
from abfm_viewer.ui import Ui


def draw(ui: Ui, session: Session) -> None:
    """Draw the menus and do what was chosen."""
    with ui.menu_bar(), ui.menu("Edit") as is_open:
        if is_open:
            if ui.menu_item("Undo", "Ctrl+Z", enabled=bool(session.history.undo_label)):
                session.undo()
            if ui.menu_item("Redo", "Ctrl+Y", enabled=bool(session.history.redo_label)):
                session.redo()
