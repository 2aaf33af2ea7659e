"""The record of where each widget is: what `abfm_viewer.automation.driver.Driver` clicks on."""

import json
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

Rect = tuple[float, float, float, float]
"""Left, top, right, bottom in window pixels."""
_Input = Literal["button", "checkbox", "combo", "choice", "slider", "box"]
WidgetKind = Literal[_Input, "section", "tab", "menu", "item", "plot", "mark"]
KINDS: tuple[WidgetKind, ...] = get_args(WidgetKind)
# of a logarithmic slider from 0: how much of it is 0, and what the rest spans
_ZERO_SHARE = 0.06
_DECADES = 6


@dataclass(frozen=True)
class Range:
    """The ends of a slider; `whole` numbers have no digits after the point."""

    low: float
    high: float
    log: bool = False
    whole: bool = False

    def nearest(self, value: float) -> float:
        return min(max(value, self.low), self.high)

    def share_of(self, value: float) -> float:
        """Return where on the slider a value is, 0 to 1."""
        if not self.log:
            return (value - self.low) / (self.high - self.low)
        if self.low > 0:
            return math.log(value / self.low) / math.log(self.high / self.low)
        if value <= 0:
            return 0.0
        decades = math.log10(value / self.high)
        return _ZERO_SHARE + (1 - _ZERO_SHARE) * max(0.0, 1 + decades / _DECADES)

    def value_at(self, share: float) -> float:
        """Return the value at a place of the slider: the inverse of `share_of`."""
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
    """A widget as it was drawn in the latest frame."""

    label: str  # what the user reads
    kind: WidgetKind
    rect: Rect
    area: Rect  # what its panel shows of the window: outside of it it must be scrolled to
    section: str  # sections, groups, menus, dialogs that it is in, slashes between, outermost first
    enabled: bool
    ends: Range = Range(0, 1)  # a slider's
    text: str = ""  # what it shows: a box's text, a combo's choice, a slider's value
    grab: float = 0.0  # a slider's, in pixels
    name: str = ""  # what scripts call it, as files call a parameter, unless that is the label
    shown: str = ""  # what there was room for of a label that is drawn on the widget
    tip: str = ""

    @property
    def path(self) -> str:
        return f"{self.section}/{self.label}"

    def is_called(self, label: str) -> bool:
        return label in (self.label, self.name)

    def is_within(self, section: str) -> bool:
        """Return whether this is its section, or one around it."""
        return section == self.section or section in self.section.split("/")


class WidgetRecord:
    """The widgets of a frame while it is drawn; `latest` are those of the latest whole one."""

    def __init__(self) -> None:
        self.latest: list[Widget] = []
        self._drawn: list[Widget] = []
        self.areas: list[Rect] = []
        self._sections: list[str] = [""]
        self._disabled = 0

    def begin_frame(self, window: Rect) -> None:
        """Start anew, in a window that is seen as a whole."""
        self._drawn, self.areas, self._sections, self._disabled = [], [window], [""], 0

    def end_frame(self) -> None:
        self.latest = self._drawn

    @property
    def enabled(self) -> bool:
        return not self._disabled

    def path(self, name: str) -> str:
        """Return a name in the present section, different from those in all others."""
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
    def disabled(self, condition: bool) -> Iterator[None]:
        """Mark what is drawn in the block as of no use, if the condition holds."""
        self._disabled += condition
        try:
            yield
        finally:
            self._disabled -= condition

    def add(
        self, label: str, kind: WidgetKind, rect: Rect, enabled: bool = True, **details: Any
    ) -> None:
        """Remember a widget; the details are other attributes of `Widget`."""
        section, usable = "/".join(self._sections[1:]), enabled and self.enabled
        self._drawn.append(Widget(label, kind, rect, self.areas[-1], section, usable, **details))


def write_widgets(widgets: Sequence[Widget], frame: int) -> None:
    """Write the widgets of every third frame as JSON into the file that the environment names: for
    programs that drive a real window with a mouse of their own.
    """
    name = os.environ.get("ABFM_WIDGETS")
    if name and frame % 3 == 0:
        temporary = Path(f"{name}.part")
        temporary.write_text(json.dumps([asdict(widget) for widget in widgets]))
        temporary.replace(name)
