"""The record of where each widget is: what `abfm_viewer.automation.driver.Driver` clicks on.

Labels are exactly what the user reads.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal, get_args

Rect = tuple[float, float, float, float]
"""Left, top, right, bottom in window pixels."""
WidgetKind = Literal["button", "checkbox", "combo", "choice", "slider", "box", "section", "menu", "item", "plot"]
KINDS: tuple[WidgetKind, ...] = get_args(WidgetKind)


@dataclass(frozen=True)
class Widget:
    """A widget as it was drawn in the latest frame.

    Attributes
    ----------
    label : str
        What the user reads on it or beside it.
    kind : WidgetKind
    rect : Rect
    area : Rect
        The part of the window that its panel shows; a widget outside of it must be scrolled to.
    section : str
        The sections, groups, menus or dialogs that it is in, outermost first, with slashes between.
    enabled : bool
    low, high : float
        Ends of a slider.
    log : bool
        Whether the slider is logarithmic.
    text : str
        What it shows: a box's text, a combo's choice, a slider's value.
    grab : float
        Width of a slider's grab, in pixels.
    """

    label: str
    kind: WidgetKind
    rect: Rect
    area: Rect
    section: str
    enabled: bool
    low: float = 0.0
    high: float = 0.0
    log: bool = False
    text: str = ""
    grab: float = 0.0


class WidgetRecord:
    """Remembers the widgets of a frame while it is drawn.

    Attributes
    ----------
    latest : list of Widget
        Those of the latest whole frame.
    """

    def __init__(self) -> None:
        self.latest: list[Widget] = []
        self._drawn: list[Widget] = []
        self._areas: list[Rect] = []
        self._sections: list[str] = [""]
        self._disabled = 0

    def begin_frame(self, window: Rect) -> None:
        """Start anew, in a window that is seen as a whole."""
        self._drawn, self._areas, self._sections, self._disabled = [], [window], [""], 0

    def end_frame(self) -> None:
        """Publish what was drawn."""
        self.latest = self._drawn

    @property
    def window(self) -> Rect:
        """The whole window."""
        return self._areas[0]

    @property
    def enabled(self) -> bool:
        """Whether what is drawn now can be used."""
        return not self._disabled

    def path(self, name: str) -> str:
        """A name for something in the present section, different from those in all others."""
        return "/".join([*self._sections, name])

    @contextmanager
    def section(self, name: str) -> Iterator[None]:
        """What is drawn in the block is in a section, group, menu or dialog."""
        self._sections.append(name)
        try:
            yield
        finally:
            self._sections.pop()

    @contextmanager
    def area(self, rect: Rect) -> Iterator[None]:
        """What is drawn in the block is seen in a part of the window only."""
        self._areas.append(rect)
        try:
            yield
        finally:
            self._areas.pop()

    @contextmanager
    def disabled(self, condition: bool) -> Iterator[None]:
        """What is drawn in the block cannot be used, if the condition holds."""
        self._disabled += condition
        try:
            yield
        finally:
            self._disabled -= condition

    def add(self, label: str, kind: WidgetKind, rect: Rect, enabled: bool = True, **details: Any) -> None:
        """Remember a widget; the details are other attributes of `Widget`."""
        section, usable = "/".join(self._sections[1:]), enabled and self.enabled
        self._drawn.append(Widget(label, kind, rect, self._areas[-1], section, usable, **details))
