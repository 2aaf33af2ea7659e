"""The record of where each widget is: what `abfm_viewer.automation.driver.Driver` clicks on."""

import json
import os
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

from abfm_viewer.widgets.slider_range import Range

Item = TypeVar("Item")

Rect = tuple[float, float, float, float]
"""Left, top, right, bottom in window pixels."""
_Input = Literal["button", "checkbox", "combo", "choice", "slider", "box"]
WidgetKind = Literal[_Input, "section", "tab", "menu", "item", "plot"]
KINDS: tuple[WidgetKind, ...] = get_args(WidgetKind)
VARIABLE = "ABFM_WIDGETS"
"""Names the file in which `write_widgets` says where the widgets are, if it is to be written."""
_FRAMES = 3


@dataclass(frozen=True)
class Widget:
    """A widget as it was drawn in the latest frame; its label is what the user reads.

    Its `name` is what scripts call it, too, as files call a parameter; empty where that is the
    label. `shown` is what there was room for of a label that is drawn on the widget, `tip` its
    tooltip.

    `area` is the part of the window that its panel shows: a widget outside of it must be scrolled
    to. `section` are the sections, groups, menus or dialogs that it is in, outermost first, with
    slashes between. `text` is what it shows: a box's text, a combo's choice, a slider's value. The
    `ends` and the width of its `grab` in pixels are a slider's.
    """

    label: str
    kind: WidgetKind
    rect: Rect
    area: Rect
    section: str
    enabled: bool
    ends: Range = Range(0, 1)
    text: str = ""
    grab: float = 0.0
    name: str = ""
    shown: str = ""
    tip: str = ""

    @property
    def path(self) -> str:
        """Its section and its label, with slashes between."""
        return f"{self.section}/{self.label}"

    def is_called(self, label: str) -> bool:
        """Return whether this is its label or its name."""
        return label in (self.label, self.name)

    def is_within(self, section: str) -> bool:
        """Return whether this is its section, or one around it."""
        return section == self.section or section in self.section.split("/")


class WidgetRecord:
    """The widgets of a frame while it is drawn; `latest` are those of the latest whole one."""

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
        """Return a name in the present section, different from those in all others."""
        return "/".join([*self._sections, name])

    def section(self, name: str) -> AbstractContextManager[None]:
        """Put what is drawn in the block into a section, group, menu or dialog."""
        return _within(self._sections, name)

    def area(self, rect: Rect) -> AbstractContextManager[None]:
        """Show what is drawn in the block in a part of the window only."""
        return _within(self._areas, rect)

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
        self._drawn.append(Widget(label, kind, rect, self._areas[-1], section, usable, **details))


@contextmanager
def _within(parts: list[Item], part: Item) -> Iterator[None]:
    parts.append(part)
    try:
        yield
    finally:
        parts.pop()


def write_widgets(widgets: Sequence[Widget], frame: int) -> None:
    """Write the widgets of every third frame as JSON, if `VARIABLE` asks for it: for programs that
    drive a real window with a mouse of their own.
    """
    name = os.environ.get(VARIABLE)
    if name and frame % _FRAMES == 0:
        temporary = Path(f"{name}.part")
        temporary.write_text(json.dumps([asdict(widget) for widget in widgets]))
        temporary.replace(name)
