"""The column at the right: the solver always in view, and a tab for each step of the work."""

from collections.abc import Callable

import polyscope.imgui as imgui

from abfm_viewer.panels import (
    energy,
    export,
    film,
    functions,
    initial_map,
    intervals,
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
OF_FILMS: dict[str, dict[str, Callable[[Context], None]]] = {
    "Functions": {"frames": film.draw_frames, "two frames": film.draw_pair},
    "Match": {"settings": film.draw_settings, "intervals": intervals.draw},
    "Look": {
        "coloring": look.draw_coloring,
        "field": look.draw_field,
        "tracks": look.draw_tracks,
        "clicks": look.draw_clicks,
        "compare": look.draw_compare,
        "numbers": look.draw_numbers,
    },
    "Export": TABS["Export"],
}
"""The same where a film is open."""
# of a tab, at a scale of 1; where a long verdict leaves less, the column scrolls
_TAB_HEIGHT_MIN = 120
STEPS = "steps"
"""Where the tabs are, for the Driver: the button Match has the name of one of them."""


def draw(context: Context, rect: Rect, guarded: Callable[..., None]) -> None:
    """Draw the column; a part that fails does not take the others with it."""
    ui, session = context.ui, context.session
    document = session.document
    accepted = (document.identity, session.channels, session.parameters, document.mask)
    of_film = document.film, document.settings
    ui.refusals.accept_after(*accepted, *of_film, session.result, session.running)
    parts = TABS if document.film is None else OF_FILMS
    with window(ui, "panel", rect, scrolls=True):
        guarded("Solver", solver.draw, context)
        label = tabs(ui, STEPS, tuple(TABS))
        is_low = imgui.GetContentRegionAvail()[1] < ui.px(_TAB_HEIGHT_MIN)
        with child(ui, label, 0, False, "at least" if is_low else "exactly"), ui.group(label):
            for part, draw_part in parts[label].items():
                guarded(part, draw_part, context)
