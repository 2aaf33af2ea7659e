"""What a click on a surface does: flow lines, and points that are followed."""

from abfm_viewer.document.document import CLICK_TOOLS
from abfm_viewer.panels.context import Context

_TIPS = ("Nothing.", "A flow line through the point.", "Follow where the point goes over time.")


def draw(context: Context) -> None:
    ui, document, editor = context.ui, context.session.document, context.session.editor
    ui.heading("a click on a surface")
    tool = ui.radio(CLICK_TOOLS, document.view.tool, _TIPS)
    editor.set_view("choose what a click does", tool=tool)
    if ui.button("Clear lines", "Remove all flow lines.", enabled=bool(document.lines)):
        editor.change("clear lines", lines=())
    ui.beside_if_fits("Clear points")
    if ui.button("Clear points", "Follow no points any more.", enabled=bool(document.points)):
        editor.change("clear points", points=())
