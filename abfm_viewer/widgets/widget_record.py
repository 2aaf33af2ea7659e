"""Record of the positions of all widgets, used by `abfm_viewer.automation.driver.Driver`."""

import json
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

Rect = tuple[float, float, float, float]  # left, top, right, bottom in window pixels
_Input = Literal["button", "checkbox", "combo", "choice", "slider", "box"]
WidgetKind = Literal[_Input, "section", "tab", "menu", "item", "plot", "marker"]
KINDS: tuple[WidgetKind, ...] = get_args(WidgetKind)
WIDGETS_VARIABLE = "ABFM_WIDGETS"
# logarithmic sliders from 0: share of the slider for 0, and number of decades on the rest
_ZERO_SHARE = 0.06
_DECADES = 6


@dataclass(frozen=True)
class Range:
    """Range of a slider, linear or logarithmic."""

    low: float
    high: float
    log: bool = False
    is_integer: bool = False

    def nearest(self, value: float) -> float:
        return min(max(value, self.low), self.high)

    def share_of(self, value: float) -> float:
        """Return the position of a value on the slider, 0 to 1."""
        if not self.log:
            return (value - self.low) / (self.high - self.low)
        if self.low > 0:
            return math.log(value / self.low) / math.log(self.high / self.low)
        if value <= 0:
            return 0.0
        decades = math.log10(value / self.high)
        return _ZERO_SHARE + (1 - _ZERO_SHARE) * max(0.0, 1 + decades / _DECADES)

    def value_at(self, share: float) -> float:
        """Return the value at a position of the slider; the inverse of `share_of`."""
        if not self.log:
            return self.low + share * (self.high - self.low)
        if self.low > 0:
            return float(self.low * (self.high / self.low) ** share)
        if share < _ZERO_SHARE / 2:
            return 0.0
        decades = _DECADES * (max(share, _ZERO_SHARE) - 1) / (1 - _ZERO_SHARE)
        return float(self.high * 10**decades)


@dataclass(frozen=True)
class Widget:
    """A widget with its position and state in the latest frame."""

    label: str  # text that the user reads
    kind: WidgetKind
    rect: Rect
    area: Rect  # visible area of its panel; widgets outside of it need scrolling
    section: str  # path of sections, groups, menus and dialogs around it, outermost first
    enabled: bool
    ends: Range = Range(0, 1)  # of a slider
    text: str = ""  # contents: text of a box, choice of a combo, value of a slider
    grab: float = 0.0  # width of a slider's grab in pixels
    name: str = ""  # for scripts, such as a parameter's name in files; empty if it is the label
    shown: str = ""  # part of the label that fits on the widget
    tip: str = ""  # tooltip
    keys: str = ""  # shortcut of a menu item

    @property
    def path(self) -> str:
        return f"{self.section}/{self.label}"

    @property
    def key(self) -> tuple[str, ...]:
        """Path, kind and name, by which the widget is found in another frame."""
        return self.path, self.kind, self.name

    def is_called(self, label: str) -> bool:
        return label in (self.label, self.name)

    def is_within(self, section: str) -> bool:
        """Return whether the widget is in a section, directly or in a nested one."""
        return section == self.section or section in self.section.split("/")


class WidgetRecord:
    """Record of the widgets of a frame."""

    def __init__(self) -> None:
        self.latest: list[Widget] = []  # of the latest complete frame
        self._drawn: list[Widget] = []
        self.areas: list[Rect] = []
        self._sections: list[str] = [""]
        self._disabled = 0

    def begin_frame(self, window: Rect) -> None:
        """Start the record of a frame; ``window`` is the area of the window."""
        self._drawn, self.areas, self._sections, self._disabled = [], [window], [""], 0

    def end_frame(self) -> None:
        self.latest = self._drawn

    @property
    def drawn(self) -> list[Widget]:
        """Widgets of the frame in progress, so far."""
        return self._drawn

    @property
    def enabled(self) -> bool:
        return not self._disabled

    def path(self, name: str) -> str:
        """Return the path of a name in the current section; paths are unique."""
        return "/".join([*self._sections, name])

    @contextmanager
    def within(self, section: str = "", area: Rect | None = None) -> Iterator[None]:
        sections, areas = self._sections, self.areas
        self._sections = [*sections, section] if section else sections
        self.areas = [*areas, area] if area else areas
        try:
            yield
        finally:
            self._sections, self.areas = sections, areas

    @contextmanager
    def disabled(self) -> Iterator[None]:
        self._disabled += 1
        try:
            yield
        finally:
            self._disabled -= 1

    def add(
        self, label: str, kind: WidgetKind, rect: Rect, enabled: bool = True, **details: Any
    ) -> Widget:
        """Record a widget and return it; the details are other attributes of `Widget`."""
        section, usable = "/".join(self._sections[1:]), enabled and self.enabled
        widget = Widget(label, kind, rect, self.areas[-1], section, usable, **details)
        self._drawn.append(widget)
        return widget

    def describe(self, tip: str) -> None:
        """Record the tooltip of the latest widget."""
        self._drawn[-1] = replace(self._drawn[-1], tip=tip)


def write_widgets(widgets: Sequence[Widget], frame: int) -> None:
    """Write the widgets of every third frame as JSON to the file named by `WIDGETS_VARIABLE`.

    Programs that operate the window with a mouse read this file.
    """
    name = os.environ.get(WIDGETS_VARIABLE)
    if name and frame % 3 == 0:
        temporary = Path(f"{name}.part")
        text = json.dumps([asdict(widget) for widget in widgets])
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(name)
