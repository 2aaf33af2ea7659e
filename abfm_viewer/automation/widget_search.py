"""Search of widgets by label, which opens tabs, sections and menus, and scrolls."""

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

_TURNS_MAX = 40  # of the wheel, to scroll a widget into view
_TRIES_MAX = 5  # to point at a moving widget
_PIXELS_PER_TURN = 100.0
_FOLDER_SECONDS = 1.0  # to read a folder for a file dialog


class WidgetSearch:
    """Search of widgets in a window; `found` has each found widget, in its state at that time."""

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
        """Return a widget, scrolled into view.

        Raises `DriverError` if there is no such widget, there are several, or it is disabled.
        """
        self._window.tick()
        widget = self._after_opening(label, within, kinds)
        if must_be_enabled and not widget.enabled:
            raise DriverError(f"{label!r} is disabled now, so it cannot be used")
        widget = self._scrolled_to(widget)
        self.found.append(widget)
        return widget

    def point_at(self, widget: Widget, place: Callable[[Widget], Place]) -> None:
        """Move the mouse to a place of a widget.

        The widget may move, also out of view, when the layout above it changes.
        """
        for _ in range(_TRIES_MAX):
            self._input.move(*place(widget))
            before, widget = widget, self._again(widget) or widget
            if widget.rect == before.rect:
                return
            widget = self._scrolled_to(widget)

    def _named(self, label: str, within: str, kinds: Sequence[WidgetKind] | None) -> Widget | None:
        """Return the drawn widget with a label; None if there is no such widget.

        Tabs and disabled widgets are considered only if no other widget has the label. Raises
        `DriverError` if several widgets have it.
        """
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
            hint = "pass one of them as within="
        elif len(usable) > 1 and sorted(widget.kind for widget in usable) != ["box", "slider"]:
            hint = "the labels in one section must differ"
        else:
            return max(usable, key=lambda widget: widget.kind == "box")
        sections = ", ".join(map(repr, dict.fromkeys(widget.section for widget in usable)))
        raise DriverError(f"there are {len(usable)} widgets {label!r}, in {sections}: {hint}")

    def _drawn(self, kind: WidgetKind | None = None) -> list[Widget]:
        widgets = self._window.ui.widgets
        return [widget for widget in widgets if kind in (None, widget.kind)]

    def _after_opening(self, label: str, within: str, kinds: Sequence[WidgetKind] | None) -> Widget:
        """Return a widget after opening tabs, sections and menus, one by one, until it is found."""
        labels: dict[str, None] = {}  # ordered
        for _ in chain([None], self._frames_of_a_dialog(), self._openings(within, kinds)):
            if (widget := self._named(label, within, kinds)) is not None:
                return widget
            for widget in self._drawn():
                labels |= dict.fromkeys(filter(None, (widget.label, widget.name)))
        hint = f"the labels are {', '.join(labels)}"
        if nearest := get_close_matches(label, labels, n=3):
            hint = f"did you mean {' or '.join(map(repr, nearest))}"
        where = f" in {within!r}" if within else ""
        raise DriverError(f"the window has no widget {label!r}{where}; {hint}")

    def _frames_of_a_dialog(self) -> Iterator[None]:
        end = time.monotonic() + _FOLDER_SECONDS
        while self._window.dialogs.is_open and time.monotonic() < end:
            self._window.frame()
            yield

    def _openings(self, within: str, kinds: Sequence[WidgetKind] | None) -> Iterator[None]:
        """Open and close sections, tabs and menus one after another, beginning with ``within``.

        The caller searches for the widget after each of these actions.
        """
        of_menus = kinds is not None and set(kinds) <= {"menu", "item"}
        if of_menus or within in [menu.label for menu in self._drawn("menu")]:
            yield from self._open_menus(within)
        if not of_menus:
            yield from self._open_sections(within, set())
            yield from self._open_tabs(within)
            yield from self._open_menus(within)

    def _open_menus(self, within: str) -> Iterator[None]:
        for menu in sorted(self._drawn("menu"), key=lambda menu: menu.label != within):
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
        same = (widget.path, widget.name)  # several boxes have the same label "auto"
        found = (one for one in self._drawn(widget.kind) if (one.path, one.name) == same)
        return next(found, None)

    def _scrolled_to(self, widget: Widget) -> Widget:
        """Return the widget after its part of the window was scrolled to show it."""
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
        raise DriverError(f"the widget {widget.label!r} cannot be scrolled into view")


def middle(widget: Widget, share: float = 0.5) -> Place:
    """Return the position at half the height of a widget, and at a share (0 to 1) of its width."""
    left, top, right, bottom = widget.rect
    return left + share * (right - left), (top + bottom) / 2
