"""The column at the right: the solver always in view, and the other panels below it in sections."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from abfm_viewer.panels import compare, energy, export, field, functions, maps, mesh, parameters, solver
from abfm_viewer.session import Session
from abfm_viewer.ui import Rect, Ui

Guard = Callable[[str, Callable[[], None]], None]

_SECTIONS: tuple[tuple[str, bool, Callable[[Ui, Session], None]], ...] = (
    ("Mesh", False, mesh.draw),
    ("Functions", True, functions.draw),
    ("Parameters", True, parameters.draw),
    ("Energy", True, energy.draw),
    ("Field", False, field.draw),
    ("Compare", False, compare.draw),
    ("Maps", False, maps.draw),
    ("Export", False, export.draw),
)


def draw(ui: Ui, session: Session, rect: Rect, guarded: Guard) -> None:
    """Draw the column; a section that fails does not take the others with it."""
    with ui.window("panel", rect):
        guarded("Solver", lambda: solver.draw(ui, session))
        with ui.child("sections", 0, border=False):
            for label, opened, draw_section in _SECTIONS:
                with ui.section(label, opened) as is_open:
                    if is_open:
                        guarded(label, partial(draw_section, ui, session))
