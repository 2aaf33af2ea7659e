"""The column at the right: the solver, and the tabs Functions, Match, Look and Export."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

import polyscope.imgui as imgui

from abfm_viewer.document import kinds
from abfm_viewer.document.document import Document
from abfm_viewer.panels import energy, export, intervals, look, parameters, solver
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.inputs import frames, functions, initial_map, landmarks
from abfm_viewer.widgets.containers import child, tabs, window
from abfm_viewer.widgets.widget_record import Rect

Draw = Callable[[Context], None]
Draws = Mapping[str, Draw]
Tabs = dict[str, dict[str, Draw]]


class Panels(NamedTuple):
    """Panels for a kind of document: a function that draws the state of its run, and its tabs."""

    state: Draw
    tabs: Tabs  # by label; the parts of a tab are below each other


def _tabs(
    functions: Draws, match: Draws, links: Draws | None = None, tracks: Draws | None = None
) -> Tabs:
    shown: dict[str, Draw] = {
        "coloring": look.draw_coloring,
        **(links or {}),
        "field": look.draw_field,
        **(tracks or {}),
        "clicks": look.draw_clicks,
        "compare": look.draw_compare,
        "numbers": look.draw_numbers,
    }
    return {
        "Functions": dict(functions),
        "Match": dict(match),
        "Look": shown,
        "Export": {"export": export.draw},
    }


_DRAFT: Draws = {"landmarks": landmarks.draw, "functions": functions.draw}
_MATCH: Draws = {"parameters": parameters.draw, "energy": energy.draw}
TABS = _tabs({"mesh": functions.draw_mesh, **_DRAFT}, _MATCH)
_PAIR_TABS = _tabs(
    {"mesh": functions.draw_meshes, **_DRAFT, "initial map": initial_map.draw_notes},
    _MATCH,
    links={"links": look.draw_links},
)
_SEQUENCE_TABS = _tabs(
    {"frames": frames.draw_frames, "two frames": frames.draw_pair},
    {"settings": frames.draw_settings, "intervals": intervals.draw},
    tracks={"tracks": look.draw_tracks},
)
PANELS: dict[type[Document], Panels] = {
    kinds.MatchDocument: Panels(solver.draw_match, TABS),
    kinds.SubjectDocument: Panels(solver.draw_subject, TABS),
    kinds.PairDocument: Panels(solver.draw_match, _PAIR_TABS),
    kinds.SequenceDocument: Panels(solver.draw_sequence, _SEQUENCE_TABS),
}
"""State and tabs that the column shows, by the kind of the current document."""
# height of a tab at scale 1; if a long verdict leaves less, the complete column scrolls
_TAB_HEIGHT_MIN = 120
STEPS = "steps"
"""Section of the tabs; in the Driver, it distinguishes the tab Match from the button Match."""


def draw(context: Context, rect: Rect, guarded: Callable[..., None]) -> None:
    """Draw the column at the right; an error in one of its parts does not affect the others."""
    ui, session = context.ui, context.session
    document = session.document
    names = (name for name in document.content_fields if name not in Document.content_fields)
    drafted = (getattr(document, name) for name in names)
    ui.refusals.accept_after(document.identity, *drafted, document.result, session.solver.running)
    panels = PANELS[type(document)]
    with window(ui, "panel", rect, scrolls=True):
        guarded("Solver", partial(solver.draw, draw_state=panels.state), context)
        label = tabs(ui, STEPS, tuple(TABS))
        is_low = imgui.GetContentRegionAvail()[1] < ui.px(_TAB_HEIGHT_MIN)
        with child(ui, label, 0, False, "at least" if is_low else "exactly"), ui.group(label):
            _draw_tab(context, label, guarded)


def list_tabs(context: Context, guarded: Callable[..., None]) -> None:
    """Draw the parts of all tabs, for the record of widgets that are not visible."""
    for label in TABS:
        with context.ui.group(label):
            _draw_tab(context, label, guarded)


def _draw_tab(context: Context, label: str, guarded: Callable[..., None]) -> None:
    kind = type(context.session.document)
    for part, draw_part in PANELS[kind].tabs[label].items():
        # a part that was drawn before may have opened another kind of document
        if type(context.session.document) is kind:
            guarded(part, draw_part, context)
