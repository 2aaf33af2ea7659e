"""The channels, and the source and the target of the active one."""

from __future__ import annotations

from abfm_viewer.document.document import Side
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.toolkit import Ui

_SIDES: tuple[Side, ...] = ("source", "target")


def draw(ui: Ui, session: Session) -> None:
    """Draw the list of channels and the editors of both sides."""
    if session.active is None:
        ui.note("A source and a target for this mesh are being chosen ...")
        return
    from abfm_viewer.panels import channels, function_editor  # not before: they load what the first frame does without

    channels.draw(ui, session)
    for side in _SIDES:
        with ui.group(side):
            ui.heading(side, ui.colors.source if side == "source" else ui.colors.target)
            function_editor.draw(ui, session, side)
    ui.note("Shift-click or drag on the source or target to move its Gaussian; Shift-wheel sets its width.")
