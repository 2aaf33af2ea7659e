"""Dialog in which the user searches an action by words, and chooses it by arrow keys and Enter."""

from collections.abc import Sequence
from dataclasses import dataclass

import polyscope.imgui as imgui

from abfm_viewer.widgets.containers import child, dialog
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.widgets.widget_record import Widget

_WIDTH = 560
_HEIGHT = 420
_ROWS_MAX = 60


@dataclass(frozen=True)
class Entry:
    """An action: its label and the place where it is found, its shortcut, and its widget.

    A disabled action has a reason. An entry without a widget explains a topic.
    """

    label: str
    place: str
    keys: str = ""
    reason: str = ""
    widget: Widget | None = None

    @property
    def text(self) -> str:
        return f"{self.place} > {self.label}" if self.place else self.label


def matching(entries: Sequence[Entry], query: str) -> list[Entry]:
    """Return the entries that contain all words of a query, the best first.

    The best are those whose label begins with the query, then those whose label contains it.
    Disabled actions are last, before topics of help.
    """
    wanted = query.lower().split()
    phrase = " ".join(wanted)

    def rank(entry: Entry) -> tuple[bool, ...]:
        label = entry.label.lower()
        is_start = label.startswith(phrase) or f"({phrase}" in label
        return entry.widget is None, bool(entry.reason), not is_start, phrase not in label

    found = [each for each in entries if all(word in each.text.lower() for word in wanted)]
    return sorted(found, key=rank) if wanted else found


class Palette:
    """The dialog; `draw` returns a tuple with the chosen entry, or with None to close."""

    title = "Search actions"

    def __init__(self, entries: Sequence[Entry]) -> None:
        self._entries = entries
        self._query, self._chosen, self._is_new = "", 0, True

    def draw(self, ui: Ui) -> tuple[Entry | None] | None:
        with dialog(ui, self.title, _WIDTH, _HEIGHT):
            hint, width = "type words, then press Enter", imgui.GetContentRegionAvail()[0]
            query = ui.live_text("##words", self._query, hint, focus=self._is_new, width=width)
            self._is_new = False
            if query != self._query:
                self._query, self._chosen = query, 0
            found = matching(self._entries, self._query)
            shown = found[:_ROWS_MAX]
            moves = _pressed(imgui.ImGuiKey_DownArrow) - _pressed(imgui.ImGuiKey_UpArrow)
            self._chosen = min(max(self._chosen + moves, 0), max(len(shown) - 1, 0))
            clicked = None
            with child(ui, "actions", -1):
                for number, entry in enumerate(shown):
                    if self._draw_row(ui, entry, number == self._chosen, moves != 0):
                        clicked = entry
                if not found:
                    ui.note("No action has these words.")
                elif len(found) > len(shown):
                    ui.note(f"{len(found) - len(shown)} more; type another word.")
            if imgui.IsKeyPressed(imgui.ImGuiKey_Enter, False) and shown:
                clicked = shown[self._chosen]
            if clicked is not None and not clicked.reason:
                return (clicked,)
            return (None,) if imgui.IsKeyPressed(imgui.ImGuiKey_Escape, False) else None

    def _draw_row(self, ui: Ui, entry: Entry, is_chosen: bool, moved: bool) -> bool:
        more = f" ({entry.keys})" if entry.keys else ""
        reason = f": {entry.reason}" if entry.reason else ""
        with ui.disabled(bool(entry.reason)):
            clicked, _ = ui.row(f"{entry.text}{more}{reason}", is_chosen)
            if is_chosen and moved:
                imgui.SetScrollHereY(0.5)
        return clicked


def _pressed(key: imgui.ImGuiKey) -> int:
    return int(imgui.IsKeyPressed(key, True))
