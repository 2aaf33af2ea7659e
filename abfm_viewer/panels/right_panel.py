"""The column at the right: the solver always in view, and a tab for each step of the work."""

from collections.abc import Callable
from functools import partial
from types import ModuleType

from abfm_viewer.panels import energy, export, functions, mesh, parameters, solver
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.look import clicks, coloring, compare, field, numbers
from abfm_viewer.widgets.containers import child, tabs, window
from abfm_viewer.widgets.widget_record import Rect

Guard = Callable[[str, Callable[[], None]], None]
# by label, what `draw` of these modules draws in it, one below the other
TABS: dict[str, dict[str, ModuleType]] = {
    "Functions": {"mesh": mesh, "functions": functions},
    "Match": {"parameters": parameters, "energy": energy},
    "Look": {
        "coloring": coloring,
        "field": field,
        "clicks": clicks,
        "compare": compare,
        "numbers": numbers,
    },
    "Export": {"export": export},
}
STEPS = "steps"
"""Where the tabs are, for the Driver: the button Match has the name of one of them."""


def draw(context: Context, rect: Rect, guarded: Guard) -> None:
    """Draw the column; a part that fails does not take the others with it."""
    ui = context.ui
    session = context.session
    accepted = (
        session.document.identity,
        session.channels,
        session.parameters,
        session.document.mask,
        session.result,
    )
    ui.refusals.accept_after(*accepted, session.solver.running)
    with window(ui, "panel", rect):
        guarded("Solver", lambda: solver.draw(context))
        label = tabs(ui, STEPS, tuple(TABS))
        with child(ui, label, 0, border=False), ui.group(label):
            for part, panel in TABS[label].items():
                guarded(part, partial(panel.draw, context))
