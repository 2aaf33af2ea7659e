"""Words in the window: notes, headings, tooltips, captions of widgets, and what is cut where there is no room."""

import math
from collections.abc import Sequence
from typing import Literal

import polyscope.imgui as imgui

from abfm_viewer.appearance.abbreviation import cut
from abfm_viewer.appearance.theme import Color
from abfm_viewer.document.document import Theme
from abfm_viewer.widgets.card import Cards

_AWAY = 8  # how far the mouse moves before tooltips come again
_CAPTION = 96  # the column of captions, at a scale of 1
_WIDEST_CAPTION = 0.45  # of the panel
_NARROW = 280  # a panel as narrow has captions above its widgets
_NARROW_PAIR = 300

Kind = Literal["ink", "muted", "failure", "good", "source", "target"]
"""Colours of texts, by their names in the theme."""


class Texts(Cards):
    """Draws words, in containers."""

    def __init__(self) -> None:
        super().__init__()
        self._clicked_at: tuple[float, float] | None = None

    def begin_frame(self, scale: float, name: Theme) -> None:
        super().begin_frame(scale, name)
        x, y = imgui.GetIO().MousePos
        if imgui.IsMouseClicked(0):
            self._clicked_at = (x, y)
        elif self._clicked_at and math.dist(self._clicked_at, (x, y)) > self.px(_AWAY):
            self._clicked_at = None

    def note(self, text: str, kind: Kind = "muted") -> None:
        """Text that wraps at the panel's edge."""
        imgui.PushStyleColor(imgui.ImGuiCol_Text, getattr(self.colors, kind))
        imgui.PushTextWrapPos(0)
        imgui.TextUnformatted(text)
        imgui.PopTextWrapPos()
        imgui.PopStyleColor()

    def line(self, text: str, kind: Kind = "muted", tip: str = "", room: float = 0) -> None:
        """Text on one line, cut where its room in pixels ends, by default the panel's; the tooltip has all of it."""
        shown = self.fitted(text, room or imgui.GetContentRegionAvail()[0])
        imgui.PushStyleColor(imgui.ImGuiCol_Text, getattr(self.colors, kind))
        imgui.TextUnformatted(shown)
        imgui.PopStyleColor()
        self.tip("\n\n".join(filter(None, [text if shown != text else "", tip])))

    def heading(self, text: str, color: Color | None = None, buttons: Sequence[str] = ()) -> None:
        """A title with a line; buttons with these labels, drawn next, stand at its right if they fit."""
        left, _ = imgui.GetCursorScreenPos()
        right = left + imgui.GetContentRegionAvail()[0]
        spacing, padding = imgui.GetStyle().ItemSpacing[0], 2 * imgui.GetStyle().FramePadding[0]
        room = sum(self.text_width(label) + padding + spacing for label in buttons)
        if room > right - left - self.text_width(text) - spacing:
            room = 0
        if room:
            self.align()
        imgui.PushStyleColor(imgui.ImGuiCol_Text, color or self.colors.muted)
        imgui.TextUnformatted(text)
        imgui.PopStyleColor()
        (_, above), (end, below) = imgui.GetItemRectMin(), imgui.GetItemRectMax()
        y, start, stop = round((above + below) / 2), end + spacing, right - room
        if start < stop:
            imgui.GetWindowDrawList().AddLine((start, y), (stop, y), imgui.GetColorU32(self.colors.border), self.px(1))
        if room:
            imgui.SameLine(0, stop + spacing - end)

    def align(self) -> None:
        """Put the next words at the height of those on buttons and boxes in their line."""
        imgui.AlignTextToFramePadding()

    def beside(self, spacing: float = -1) -> None:
        imgui.SameLine(0, spacing)

    def beside_if_fits(self, label: str, is_button: bool = False) -> None:
        """Put the next checkbox, or what is as wide, or a narrower button on the same line where there is room."""
        right = imgui.GetCursorScreenPos()[0] + imgui.GetContentRegionAvail()[0]
        style = imgui.GetStyle()
        more = style.ItemSpacing[0] + 2 * style.FramePadding[0] if is_button else self.px(42)
        if imgui.GetItemRectMax()[0] + self.text_width(label) + more <= right + 1:
            imgui.SameLine()

    def text_width(self, text: str) -> float:
        """In pixels."""
        return float(imgui.CalcTextSize(text)[0])

    def fitted(self, text: str, room: float) -> str:
        """A text, cut with an ellipsis if it is wider than so many pixels."""
        return cut(text, room + 0.5, self.text_width)

    def tip(self, text: str, above: bool = False) -> None:
        """A tooltip for the widget before; also where it is disabled. One `above` it hides nothing beside the mouse.

        Who has just clicked wants to see what comes of it: there is none until the mouse moves, nor during a drag.
        """
        flags = imgui.ImGuiHoveredFlags_AllowWhenDisabled | imgui.ImGuiHoveredFlags_DelayShort
        busy = self._clicked_at is not None or imgui.IsMouseDown(0)
        if text and not busy and imgui.IsItemHovered(flags):
            if above:
                place = imgui.GetMousePos()[0], imgui.GetItemRectMin()[1] - self.px(6)
                imgui.SetNextWindowPos(place, imgui.ImGuiCond_Always, (0.0, 1.0))
            imgui.BeginTooltip()
            imgui.PushTextWrapPos(self.px(340))
            imgui.TextUnformatted(text)
            imgui.PopTextWrapPos()
            imgui.EndTooltip()

    # Captions

    def halves(self, left: str, right: str) -> tuple[float, float]:
        """Widths of two widgets with these captions that fill a line together; zeros where the panel is too narrow."""
        room, gap = imgui.GetContentRegionAvail()[0], imgui.GetStyle().ItemInnerSpacing[0]
        if room < self.px(_NARROW_PAIR):
            return 0.0, 0.0
        cell = (room - imgui.GetStyle().ItemSpacing[0]) / 2
        return cell - gap - self.text_width(left), cell - gap - self.text_width(right)

    def placed(self, label: str, width: float = 0) -> tuple[float, float]:
        """Widths of the next widget, by default what the panel leaves, and of its caption: 0 if that is above it."""
        room, gap = float(imgui.GetContentRegionAvail()[0]), imgui.GetStyle().ItemInnerSpacing[0]
        if width:
            return width, self.text_width(label)
        if room < self.px(_NARROW):
            self.line(label, "ink")
            return room, 0.0
        caption = max(min(self.text_width(label), _WIDEST_CAPTION * room), self.px(_CAPTION))
        return room - caption - gap, caption

    def caption(self, label: str, room: float, tip: str) -> None:
        """The words beside the widget that was drawn last, in a room that `placed` gave."""
        if room:
            imgui.SameLine(0, imgui.GetStyle().ItemInnerSpacing[0])
            imgui.AlignTextToFramePadding()
            self.line(label, "ink", tip, room)
