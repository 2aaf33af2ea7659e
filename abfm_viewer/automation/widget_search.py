"""Finds widgets by their label as a user would: opens tabs and sections, looks into menus, scrolls."""

import time
from collections.abc import Callable, Iterator, Sequence
from difflib import get_close_matches
from functools import partial
from itertools import chain

from abfm_viewer.automation.input_events import InputEvents, Place
from abfm_viewer.errors import DriverError
from abfm_viewer.widgets.widget_record import Widget, WidgetKind
from abfm_viewer.window.window import Window

_MOST_TURNS, _MOST_CHASES = 40, 5
_PIXELS_PER_TURN = 100.0
_SECONDS_TO_READ_A_FOLDER = 1.0


class WidgetSearch:
    """Looks for widgets in a window; `found` are all that were asked for, as they were then."""

    def __init__(self, window: Window, input: InputEvents) -> None:
        self._window = window
        self._input = input
        self.found: list[Widget] = []

    def find(
        self, label: str, within: str = "", kinds: Sequence[WidgetKind] | None = None, must_be_enabled: bool = True
    ) -> Widget:
        """A widget in view, of the kinds that it may be; DriverError if it is grey, or none or several are there."""
        self._window.tick()
        widget = self._sought(label, within, kinds)
        if must_be_enabled and not widget.enabled:
            raise DriverError(f"{label!r} is grey now: it cannot be used")
        widget = self._scrolled_to(widget)
        self.found.append(widget)
        return widget

    def point_at(self, widget: Widget, place: Callable[[Widget], Place]) -> None:
        """Move the mouse to a place of a widget, which may itself move meanwhile as things above it change."""
        for _ in range(_MOST_CHASES):
            self._input.move(*place(widget))
            again = self._again(widget)
            if again is None or again.rect == widget.rect:
                return
            widget = again

    def drawn(self, label: str, within: str = "", kinds: Sequence[WidgetKind] | None = None) -> Widget | None:
        """A label's widget in the latest frame, of several the only enabled one; DriverError if several are."""
        candidates = [w for w in self._window.ui.widgets if w.is_called(label) and (not kinds or w.kind in kinds)]
        if within:
            candidates = [w for w in candidates if within == w.section or within in w.section.split("/")]
        candidates = [w for w in candidates if w.kind != "tab"] or candidates  # the button Match is no tab
        usable = [w for w in candidates if w.enabled] or candidates
        if len({w.section for w in usable}) > 1:
            raise DriverError(f"{label!r} is there {len(usable)} times, in {_sections(usable)}: say within= which")
        if len(usable) > 1 and sorted(w.kind for w in usable) != ["box", "slider"]:
            raise DriverError(
                f"{label!r} is there {len(usable)} times in {_sections(usable)}: labels must differ there"
            )
        return max(usable, key=lambda w: w.kind == "box") if usable else None

    def _sought(self, label: str, within: str, kinds: Sequence[WidgetKind] | None) -> Widget:
        seen: dict[str, None] = {}  # labels, in their order
        for _ in chain([None], self._frames_of_a_dialog(), self._openings(within, kinds)):
            if (widget := self.drawn(label, within, kinds)) is not None:
                return widget
            seen |= dict.fromkeys(name for w in self._window.ui.widgets for name in (w.label, w.name) if name)
        nearest = get_close_matches(label, seen, n=3)
        hint = f"did you mean {' or '.join(map(repr, nearest))}" if nearest else f"labels are {', '.join(seen)}"
        raise DriverError(f"there is no {label!r}{f' in {within!r}' if within else ''} in the window; {hint}")

    def _frames_of_a_dialog(self) -> Iterator[None]:
        end = time.monotonic() + _SECONDS_TO_READ_A_FOLDER
        while self._window.dialogs.is_open and time.monotonic() < end:
            self._window.frame()
            yield

    def _openings(self, within: str, kinds: Sequence[WidgetKind] | None) -> Iterator[None]:
        """Open what is closed, one after the other, the one asked for first; what was opened is closed again."""
        of_menus = set(kinds or ()) <= {"menu", "item"} and kinds is not None
        if of_menus or any(w.kind == "menu" and w.label == within for w in self._window.ui.widgets):
            yield from self._open_menus()
        if not of_menus:
            yield from self._open_sections(within, set())
            yield from self._open_tabs(within)
            yield from self._open_menus()

    def _open_menus(self) -> Iterator[None]:
        for menu in [w for w in self._window.ui.widgets if w.kind == "menu" and not w.section and w.enabled]:
            self._open(menu)
            yield
            for submenu in [w for w in self._window.ui.widgets if w.kind == "menu" and w.section == menu.label]:
                self._open(submenu)
                yield
            self._input.key("esc")
            self._input.key("esc")

    def _open(self, widget: Widget) -> None:
        self._input.move(*middle(widget))
        self._input.click()

    def _open_sections(self, within: str, tried: set[str]) -> Iterator[None]:
        while closed := [w for w in self._window.ui.widgets if _is_closed(w) and f"{w.section}/{w.label}" not in tried]:
            section = min(closed, key=lambda w: w.label != within)
            tried.add(f"{section.section}/{section.label}")
            self._toggle(section)
            yield
            yield from self._open_sections(within, tried)
            self._toggle(section)

    def _open_tabs(self, within: str) -> Iterator[None]:
        tabs = [w for w in self._window.ui.widgets if w.kind == "tab" and w.enabled]
        for tab in sorted((w for w in tabs if w.text == "closed"), key=lambda w: w.label != within):
            self._open(tab)
            yield
            yield from self._open_sections(within, set())
        for tab in (w for w in tabs if w.text == "open"):
            self._open(tab)

    def _toggle(self, section: Widget) -> None:
        self.point_at(self._scrolled_to(section), partial(middle, share=0.2))
        self._input.click()

    def _again(self, widget: Widget) -> Widget | None:
        name = (widget.label, widget.section, widget.kind)
        return next((w for w in self._window.ui.widgets if (w.label, w.section, w.kind) == name), None)

    def _scrolled_to(self, widget: Widget) -> Widget:
        """The widget after the part of the window that it is in was scrolled so far that it can be seen whole."""
        for turn in range(_MOST_TURNS):
            left, top, right, bottom = widget.area
            beyond = max(top - widget.rect[1], 0.0) or min(bottom - widget.rect[3], 0.0)
            fits = widget.rect[3] - widget.rect[1] <= bottom - top
            if beyond == 0 or (not fits and top <= middle(widget)[1] <= bottom):
                return widget
            self._input.move(left + 0.02 * (right - left), (top + bottom) / 2)
            self._input.wheel((1 if beyond > 0 else -1) * max(abs(beyond) / _PIXELS_PER_TURN, 0.3))
            again = self._again(widget)
            if again is None or (turn > 3 and again.rect == widget.rect):
                break
            widget = again
        raise DriverError(f"{widget.label!r} cannot be scrolled into view")


def middle(widget: Widget, share: float = 0.5) -> Place:
    """A point at half a widget's height, and at a share of its width."""
    left, top, right, bottom = widget.rect
    return left + share * (right - left), (top + bottom) / 2


def _sections(widgets: Sequence[Widget]) -> str:
    return ", ".join(repr(section) for section in dict.fromkeys(widget.section for widget in widgets))


def _is_closed(widget: Widget) -> bool:
    return widget.kind == "section" and widget.text == "closed" and widget.enabled
