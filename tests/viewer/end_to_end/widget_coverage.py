"""Which widgets the window showed, and which of them tests used."""

from __future__ import annotations

from collections.abc import Iterable

from abfm_viewer.widgets.widget_record import Widget

Name = tuple[str, str]
"""The section, menu or dialog that a widget is in, and its label."""
_SAVING = ("Save a ", "Save the ", "Export the ")


class Coverage:
    """Names of widgets that were seen where they could be used, and of those that were used."""

    def __init__(self) -> None:
        self.seen: set[Name] = set()
        self.used: set[Name] = set()

    def see(self, widgets: Iterable[Widget]) -> None:
        """Remember what a frame shows; what is drawn to be looked at, and files in a list, are left out."""
        for widget in widgets:
            if widget.enabled and widget.kind != "plot":
                self.seen.add(_name(widget))

    def use(self, widget: Widget) -> None:
        """Remember that a test asked for a widget."""
        self.used.add(_name(widget))

    def unused(self, exempt: Iterable[str]) -> set[Name]:
        """What was seen and not used, but for sections that begin with one of some texts."""
        return {name for name in self.seen - self.used if not name[0].startswith(tuple(exempt))}


def _name(widget: Widget) -> Name:
    """Where a widget is and what it is called; one name for all channels, and one for all dialogs that save."""
    section = "Save" if widget.section.startswith(_SAVING) else widget.section
    label = "channel" if section == "Functions" and widget.kind == "choice" else widget.label
    if section == "Save" and widget.kind == "choice":
        label = "file"
    return section, label
