"""Finds widgets by label as a user would: opens tabs, sections and menus, and scrolls."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from difflib import get_close_matches
from functools import partial
from itertools import chain

from abfm_viewer.automation.input_events import InputEvents, Place
from abfm_viewer.errors import DriverError
from abfm_viewer.widgets.widget_record import Widget, WidgetKind
from abfm_viewer.window.window import Window

_TURNS_MAX = 40
_CHASES_MAX = 5
_PIXELS_PER_TURN = 100.0
_SECONDS_TO_READ_A_FOLDER = 1.0


class WidgetSearch:
    """Looks for widgets in a window; `found` are all that were asked for, as they were then."""

    def __init__(self, window: Window, input: InputEvents) -> None:
        self._window = window
        self._input = input
        self.found: list[Widget] = []

    def find(
        self,
        label: str,
        within: str = "",
        kinds: Sequence[WidgetKind] | None = None,
        must_be_enabled: bool = True,
    ) -> Widget:
        """Return a widget in view; DriverError if it is grey, or none or several are there."""
        self._window.tick()
        widget = self._sought(label, within, kinds)
        if must_be_enabled and not widget.enabled:
            raise DriverError(f"{label!r} is grey now: it cannot be used")
        widget = self._scrolled_to(widget)
        self.found.append(widget)
        return widget

    def point_at(self, widget: Widget, place: Callable[[Widget], Place]) -> None:
        """Move the mouse to a place of a widget, which may move, also out of view, as things above
        it change.
        """
        for _ in range(_CHASES_MAX):
            self._input.move(*place(widget))
            before, widget = widget, self._again(widget) or widget
            if widget.rect == before.rect:
                return
            widget = self._scrolled_to(widget)

    def _named(self, label: str, within: str, kinds: Sequence[WidgetKind] | None) -> Widget | None:
        """Return the widget of a label, which means no tab and nothing grey if there is another."""
        found = [
            widget
            for widget in self._drawn()
            if widget.is_called(label)
            and (not kinds or widget.kind in kinds)
            and (not within or widget.is_within(within))
        ]
        found = [widget for widget in found if widget.kind != "tab"] or found
        usable = [widget for widget in found if widget.enabled] or found
        if not usable:
            return None
        if len({widget.section for widget in usable}) > 1:
            hint = "say within= which"
        elif len(usable) > 1 and sorted(widget.kind for widget in usable) != ["box", "slider"]:
            hint = "labels must differ there"
        else:
            return max(usable, key=lambda widget: widget.kind == "box")
        sections = ", ".join(map(repr, dict.fromkeys(widget.section for widget in usable)))
        raise DriverError(f"{label!r} is there {len(usable)} times, in {sections}: {hint}")

    def _drawn(self, kind: WidgetKind | None = None) -> list[Widget]:
        widgets = self._window.ui.widgets
        return [widget for widget in widgets if kind in (None, widget.kind)]

    def _sought(self, label: str, within: str, kinds: Sequence[WidgetKind] | None) -> Widget:
        seen: dict[str, None] = {}  # labels, in their order
        for _ in chain([None], self._frames_of_a_dialog(), self._openings(within, kinds)):
            if (widget := self._named(label, within, kinds)) is not None:
                return widget
            for widget in self._drawn():
                seen |= dict.fromkeys(filter(None, (widget.label, widget.name)))
        hint = f"labels are {', '.join(seen)}"
        if nearest := get_close_matches(label, seen, n=3):
            hint = f"did you mean {' or '.join(map(repr, nearest))}"
        where = f" in {within!r}" if within else ""
        raise DriverError(f"there is no {label!r}{where} in the window; {hint}")

    def _frames_of_a_dialog(self) -> Iterator[None]:
        end = time.monotonic() + _SECONDS_TO_READ_A_FOLDER
        while self._window.dialogs.is_open and time.monotonic() < end:
            self._window.frame()
            yield

    def _openings(self, within: str, kinds: Sequence[WidgetKind] | None) -> Iterator[None]:
        """Open and close one thing after the other, the one asked for first."""
        of_menus = kinds is not None and set(kinds) <= {"menu", "item"}
        if of_menus or within in [menu.label for menu in self._drawn("menu")]:
            yield from self._open_menus()
        if not of_menus:
            yield from self._open_sections(within, set())
            yield from self._open_tabs(within)
            yield from self._open_menus()

    def _open_menus(self) -> Iterator[None]:
        for menu in self._drawn("menu"):
            if menu.section or not menu.enabled:
                continue
            self._press(menu)
            yield
            for submenu in self._drawn("menu"):
                if submenu.section == menu.label:
                    self._press(submenu)
                    yield
            self._input.key("esc")
            self._input.key("esc")

    def _press(self, widget: Widget) -> None:
        self._input.move(*middle(widget))
        self._input.click()

    def _open_sections(self, within: str, tried: set[str]) -> Iterator[None]:
        def closed() -> list[Widget]:
            sections = [one for one in self._drawn("section") if one.path not in tried]
            return [section for section in sections if section.text == "closed" and section.enabled]

        while found := closed():
            section = min(found, key=lambda section: section.label != within)
            tried.add(section.path)
            self._toggle(section)
            yield
            yield from self._open_sections(within, tried)
            self._toggle(section)

    def _open_tabs(self, within: str) -> Iterator[None]:
        tabs = [tab for tab in self._drawn("tab") if tab.enabled]
        for tab in sorted(tabs, key=lambda tab: tab.label != within):
            if tab.text == "closed":
                self._press(tab)
                yield
                yield from self._open_sections(within, set())
        for tab in (tab for tab in tabs if tab.text == "open"):
            self._press(tab)

    def _toggle(self, section: Widget) -> None:
        self.point_at(self._scrolled_to(section), partial(middle, share=0.2))
        self._input.click()

    def _again(self, widget: Widget) -> Widget | None:
        same = (widget.path, widget.name)  # boxes beside sliders share the word "auto"
        found = (one for one in self._drawn(widget.kind) if (one.path, one.name) == same)
        return next(found, None)

    def _scrolled_to(self, widget: Widget) -> Widget:
        """Return the widget after the part of the window that it is in was scrolled to show it."""
        for turn in range(_TURNS_MAX):
            left, top, right, bottom = widget.area
            _, upper, _, lower = widget.rect
            beyond = max(top - upper, 0.0) or min(bottom - lower, 0.0)
            is_higher = lower - upper > bottom - top
            if beyond == 0 or (is_higher and top <= middle(widget)[1] <= bottom):
                return widget
            self._input.move(left + 0.02 * (right - left), (top + bottom) / 2)
            turns = max(abs(beyond) / _PIXELS_PER_TURN, 0.3)
            self._input.wheel(math.copysign(turns, beyond))
            again = self._again(widget)
            if again is None or (turn > 3 and again.rect == widget.rect):
                break
            widget = again
        raise DriverError(f"{widget.label!r} cannot be scrolled into view")


def middle(widget: Widget, share: float = 0.5) -> Place:
    """Return a point at half a widget's height, and at a share of its width."""
    left, top, right, bottom = widget.rect
    return left + share * (right - left), (top + bottom) / 2
