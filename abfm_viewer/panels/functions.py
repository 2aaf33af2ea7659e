"""The channels, and the source and the target of the active one."""

from abfm_viewer.document.document import SIDES
from abfm_viewer.panels import channels, function_editor
from abfm_viewer.panels.context import Context


def draw(context: Context) -> None:
    """Draw the list of channels and the editors of both sides."""
    ui, session = context.ui, context.session
    if session.active is None:
        ui.note("A source and a target for this mesh are being chosen ...")
        return

    channels.draw(context)
    for side in SIDES:
        with ui.group(side):
            ui.heading(side, ui.colors.source if side == "source" else ui.colors.target)
            function_editor.draw(context, side)
    ui.note("Shift-click or drag on the source or target to move its Gaussian; Shift-wheel sets its width.")
