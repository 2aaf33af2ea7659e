"""The column at the right: the solver always in view, and the other panels below it in sections."""

from collections.abc import Callable
from functools import partial
from types import ModuleType

from abfm_viewer.panels import compare, energy, export, field, functions, maps, mesh, parameters, solver
from abfm_viewer.panels.context import Context
from abfm_viewer.widgets.widget_record import Rect

Guard = Callable[[str, Callable[[], None]], None]
SECTIONS: tuple[tuple[str, bool, ModuleType], ...] = (  # drawn by `draw` of these modules
    ("Mesh", False, mesh),
    ("Functions", True, functions),
    ("Parameters", True, parameters),
    ("Energy", True, energy),
    ("Field", False, field),
    ("Compare", False, compare),
    ("Maps", False, maps),
    ("Export", False, export),
)


def draw(context: Context, rect: Rect, guarded: Guard) -> None:
    """Draw the column; a section that fails does not take the others with it."""
    ui = context.ui
    with ui.window("panel", rect):
        guarded("Solver", lambda: solver.draw(context))
        with ui.child("sections", 0, border=False):
            for label, opened, panel in SECTIONS:
                with ui.section(label, opened) as is_open:
                    if is_open:
                        guarded(label, partial(panel.draw, context))
