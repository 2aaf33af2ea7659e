"""The column at the right: the solver always in view, and a tab for each step of the work."""

from collections.abc import Callable

from abfm_viewer.panels import (
    energy,
    export,
    functions,
    initial_map,
    landmarks,
    look,
    parameters,
    solver,
)
from abfm_viewer.panels.context import Context
from abfm_viewer.widgets.containers import child, tabs, window
from abfm_viewer.widgets.widget_record import Rect

TABS: dict[str, dict[str, Callable[[Context], None]]] = {
    "Functions": {
        "mesh": functions.draw_mesh,
        "landmarks": landmarks.draw,
        "functions": functions.draw,
        "initial map": initial_map.draw_notes,
    },
    "Match": {"parameters": parameters.draw, "energy": energy.draw},
    "Look": {
        "coloring": look.draw_coloring,
        "field": look.draw_field,
        "clicks": look.draw_clicks,
        "compare": look.draw_compare,
        "numbers": look.draw_numbers,
    },
    "Export": {"export": export.draw},
}
"""By label, what is drawn in it, one part below the other."""
STEPS = "steps"
"""Where the tabs are, for the Driver: the button Match has the name of one of them."""


def draw(context: Context, rect: Rect, guarded: Callable[..., None]) -> None:
    """Draw the column; a part that fails does not take the others with it."""
    ui, session = context.ui, context.session
    document = session.document
    accepted = (document.identity, session.channels, session.parameters, document.mask)
    ui.refusals.accept_after(*accepted, session.result, session.solver.running)
    with window(ui, "panel", rect):
        guarded("Solver", solver.draw, context)
        label = tabs(ui, STEPS, tuple(TABS))
        with child(ui, label, 0, border=False), ui.group(label):
            for part, draw_part in TABS[label].items():
                guarded(part, draw_part, context)
