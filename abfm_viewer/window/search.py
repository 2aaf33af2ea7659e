"""Search of all actions: menu items, buttons, tabs, samples, settings, parameters and help."""

from collections.abc import Callable, Sequence

from abfm import explanations
from abfm_viewer.dialogs.palette import Entry, Palette
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.explanations import explain
from abfm_viewer.panels.right_panel import STEPS, TABS
from abfm_viewer.widgets.toolkit import HELP_TEXT
from abfm_viewer.widgets.widget_record import Widget

_KINDS = ("button", "checkbox", "choice", "box", "tab", "item")
_FRAMES_MAX = 3  # to draw a widget whose tab was closed
_HELP = "Explain"


class Search:
    """Opens the search, and performs the chosen action.

    ``draw_unseen`` draws all menus and tabs. Menu items act in such a drawing, other widgets in
    their tab, which is opened and scrolled.
    """

    def __init__(self, context: Context, draw_unseen: Callable[[], None]) -> None:
        self._context, self._draw_unseen = context, draw_unseen
        self._is_requested = False
        self._frames = 0

    def open(self) -> None:
        self._is_requested = True

    def update(self) -> None:
        """Open the search if requested. Call at the end of a frame."""
        ui = self._context.ui
        if self._is_requested and not self._context.dialogs.is_open:
            with ui.unseen() as record:
                self._draw_unseen()
            found = entries([*ui.record.drawn, *record.latest])
            self._context.dialogs.push(Palette(found), self._use)
        self._is_requested = False
        if ui.wanted is not None:
            self._frames += 1
            if self._frames > _FRAMES_MAX:
                ui.wanted = None

    def _use(self, answer: tuple[Entry | None]) -> None:
        self._context.dialogs.pop()
        if (entry := answer[0]) is None:
            return
        ui, widget = self._context.ui, entry.widget
        if widget is None:
            explain(self._context, entry.label)
            return
        ui.wanted, self._frames = widget, 0
        if widget.kind == "item":
            with ui.unseen():
                self._draw_unseen()
            return
        tab, *sections = widget.section.split("/")
        if tab in TABS:
            ui.open_tab = tab
            ui.open_sections.update({name: True for name in sections if name in ui.open_sections})


def entries(widgets: Sequence[Widget]) -> list[Entry]:
    """Return the entries of the search for widgets, each of them once, and for topics of help."""
    known: dict[tuple[str, ...], Widget] = {}
    for widget in widgets:
        if widget.kind in _KINDS and widget.label not in ("", HELP_TEXT):
            known.setdefault(widget.key, widget)
    found = [_entry(widget) for widget in known.values()]
    return [*found, *(Entry(name, _HELP) for name in explanations.names())]


def _entry(widget: Widget) -> Entry:
    place = widget.section.replace(STEPS, "tab").replace("/", " > ")
    label = widget.label
    if widget.name.lower() not in ("", label.lower()):
        label += f" ({widget.name})"
    elif place == "Samples":
        label += f": {widget.tip.partition(': ')[2]}"
    reason = "" if widget.enabled else widget.tip or "not available now"
    return Entry(label, place, widget.keys, reason.split("\n")[0], widget)
