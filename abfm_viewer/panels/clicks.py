"""What a click on a surface does: flow lines, and points that are followed."""

from abfm_viewer.document.document import CLICK_TOOLS
from abfm_viewer.panels.context import Context


def draw(context: Context) -> None:
    ui, session = context.ui, context.session
    document = session.document
    ui.heading("a click on a surface")
    tips = ("Nothing.", "A flow line through the point.", "Following where the point goes over time.")
    session.set_view("choose what a click does", tool=ui.radio(CLICK_TOOLS, session.view.tool, tips))
    if ui.button("Clear lines", "Remove all flow lines.", enabled=bool(document.lines)):
        session.change("clear lines", lines=())
    ui.beside_if_fits("Clear points")
    if ui.button("Clear points", "Follow no points any more.", enabled=bool(document.points)):
        session.change("clear points", points=())
