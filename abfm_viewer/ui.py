"""The window's widgets: ImGui's, with one look, tooltips, and a record of where each one is.

Everything that opens something is a context manager, so that an error inside leaves ImGui's stacks whole. The record
(`Ui.widgets`) is what `abfm_viewer.automation.Driver` clicks on: labels are exactly what the user reads.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

import polyscope.imgui as imgui
import polyscope.implot as implot

from abfm_viewer import theme
from abfm_viewer.document import Theme
from abfm_viewer.theme import Color, Palette

Rect = tuple[float, float, float, float]
"""Left, top, right, bottom in window pixels."""
Kind = Literal["button", "checkbox", "combo", "choice", "slider", "box", "section", "menu", "item", "plot", "canvas"]
Word = TypeVar("Word", bound=str)
ChooseToSave = Callable[[str, tuple[str, ...], str, Callable[[Path], None]], None]
ChooseToOpen = Callable[[str, tuple[str, ...], Callable[[Path], None]], None]
"""A title, suffixes, a default name, and what to do with the path."""

_DIM = 0.4
_ZERO_SHARE, _DECADES = 0.06, 6
_WINDOW = (
    imgui.ImGuiWindowFlags_NoDecoration
    | imgui.ImGuiWindowFlags_NoMove
    | imgui.ImGuiWindowFlags_NoSavedSettings
    | imgui.ImGuiWindowFlags_NoBringToFrontOnFocus
)
_DIALOG = (
    imgui.ImGuiWindowFlags_NoCollapse
    | imgui.ImGuiWindowFlags_NoResize
    | imgui.ImGuiWindowFlags_NoMove
    | imgui.ImGuiWindowFlags_NoSavedSettings
)


@dataclass(frozen=True)
class Widget:
    """A widget as it was drawn in the latest frame.

    Attributes
    ----------
    label : str
        What the user reads on it or beside it.
    kind : Kind
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
    kind: Kind
    rect: Rect
    area: Rect
    section: str
    enabled: bool
    low: float = 0.0
    high: float = 0.0
    log: bool = False
    text: str = ""
    grab: float = 0.0


class Ui:
    """Draws widgets and remembers them.

    Attributes
    ----------
    widgets : list of Widget
        Those of the latest whole frame.
    open_sections : dict of str to bool
    scroll_to : str
        A section to bring into view in the next frame.
    capturing : bool
        Whether frames are drawn for a picture: polyscope does that in a new ImGui context, which remembers nothing.
    choose_to_save : callable
        Lets the user name a file to write; see `abfm_viewer.dialogs.Dialogs.save`.
    choose_to_open : callable
        Lets the user choose a file to read; see `abfm_viewer.dialogs.Dialogs.open`.
    open_mesh : callable
        Lets the user choose a mesh, and opens it.
    """

    def __init__(self) -> None:
        self.widgets: list[Widget] = []
        self.open_sections: dict[str, bool] = {}
        self.scale = 1.0
        self.colors: Palette = theme.LIGHT
        self._drawn: list[Widget] = []
        self._areas: list[Rect] = []
        self._sections: list[str] = [""]
        self._disabled = 0
        self._texts: dict[str, str] = {}
        self._refused: dict[str, str] = {}
        self.scroll_to = ""
        self.capturing = False
        self._scrolls: dict[str, float] = {}
        self.choose_to_save: ChooseToSave = lambda title, suffixes, name, on_path: None
        self.choose_to_open: ChooseToOpen = lambda title, suffixes, on_path: None
        self.open_mesh: Callable[[], None] = lambda: None

    # Frames, windows, structure

    def begin_frame(self, scale: float, name: Theme) -> None:
        """Start the record of a frame."""
        self._drawn = []
        self.scale, self.colors = scale, theme.palette(name)
        self._areas = [(0, 0, *imgui.GetIO().DisplaySize)]
        self._sections, self._disabled = [""], 0

    def end_frame(self) -> None:
        """Publish the record."""
        self.widgets = self._drawn

    def px(self, length: float) -> float:
        """A length in pixels, for one given at a scale of 1."""
        return length * self.scale

    @contextmanager
    def window(self, name: str, rect: Rect, scrolls: bool = False, background: bool = True) -> Iterator[None]:
        """A fixed panel."""
        imgui.SetNextWindowPos(rect[:2])
        imgui.SetNextWindowSize((rect[2] - rect[0], rect[3] - rect[1]))
        flags = _WINDOW if background else _WINDOW | imgui.ImGuiWindowFlags_NoBackground
        if scrolls:
            flags &= ~imgui.ImGuiWindowFlags_NoScrollbar
            flags |= imgui.ImGuiWindowFlags_AlwaysVerticalScrollbar
        imgui.Begin(name, flags)
        self._areas.append(rect)
        self._keep_scroll(name)
        try:
            yield
        finally:
            self._areas.pop()
            imgui.End()

    def backdrop(self) -> None:
        """A veil over the whole window that keeps the mouse from what is behind it: draw it before a dialog."""
        imgui.SetNextWindowPos((0, 0))
        imgui.SetNextWindowSize(tuple(imgui.GetIO().DisplaySize))
        imgui.PushStyleColor(imgui.ImGuiCol_WindowBg, (0, 0, 0, 0.35))
        imgui.Begin("backdrop", _WINDOW & ~imgui.ImGuiWindowFlags_NoBringToFrontOnFocus)
        imgui.End()
        imgui.PopStyleColor()

    @contextmanager
    def dialog(self, title: str, width: float, height: float = 0) -> Iterator[None]:
        """A window in front of everything, in the middle; without a height it fits what is in it."""
        display = imgui.GetIO().DisplaySize
        size = (min(self.px(width), 0.96 * display[0]), min(self.px(height), 0.92 * display[1]))
        imgui.SetNextWindowPos((display[0] / 2, display[1] / 2), imgui.ImGuiCond_Always, (0.5, 0.5))
        if height:
            imgui.SetNextWindowSize(size)
        else:
            imgui.SetNextWindowSizeConstraints((size[0], 0), (size[0], 0.92 * display[1]))
        imgui.SetNextWindowFocus()
        imgui.Begin(title, _DIALOG | (0 if height else imgui.ImGuiWindowFlags_AlwaysAutoResize))
        left, top = imgui.GetWindowPos()
        self._areas.append((left, top, left + imgui.GetWindowWidth(), top + imgui.GetWindowHeight()))
        self._sections.append(title)
        try:
            yield
        finally:
            self._sections.pop()
            self._areas.pop()
            imgui.End()

    @contextmanager
    def child(self, name: str, height: float, border: bool = True, shrinks: bool = False) -> Iterator[None]:
        """A part of a panel that scrolls by itself; a negative height leaves that much below it.

        One that `shrinks` is as low as what is in it.
        """
        flags = imgui.ImGuiChildFlags_Borders if border else imgui.ImGuiChildFlags_None
        if shrinks:
            flags |= imgui.ImGuiChildFlags_AutoResizeY
            imgui.SetNextWindowSizeConstraints((0, 0), (imgui.GetContentRegionAvail()[0], height))
        imgui.BeginChild(name, (0, 0 if shrinks else height), flags)
        self._keep_scroll("/".join([*self._sections, name]))
        left, top = imgui.GetWindowPos()
        self._areas.append((left, top, left + imgui.GetWindowWidth(), top + imgui.GetWindowHeight()))
        try:
            yield
        finally:
            self._areas.pop()
            imgui.EndChild()

    @contextmanager
    def disabled(self, condition: bool = True) -> Iterator[None]:
        """Grey widgets that do nothing."""
        imgui.BeginDisabled(condition)
        self._disabled += condition
        try:
            yield
        finally:
            self._disabled -= condition
            imgui.EndDisabled()

    @contextmanager
    def group(self, name: str) -> Iterator[None]:
        """Widgets whose labels may also be found elsewhere: `name` tells them apart, also for the Driver."""
        imgui.PushID(name)
        self._sections.append(name)
        try:
            yield
        finally:
            self._sections.pop()
            imgui.PopID()

    @contextmanager
    def section(self, label: str, opened: bool = True) -> Iterator[bool]:
        """A collapsible part of the panel; yields whether it is open."""
        is_open = self.open_sections.setdefault(label, opened)
        imgui.SetNextItemOpen(is_open, imgui.ImGuiCond_Always)
        imgui.PushStyleColor(imgui.ImGuiCol_Text, self.colors.ink)
        now_open = imgui.CollapsingHeader(label)
        imgui.PopStyleColor()
        self._record(label, "section", text="open" if now_open else "closed")
        self.open_sections[label] = now_open
        if self.scroll_to == label:
            imgui.SetScrollHereY(0)
            self.scroll_to = ""
        imgui.PushID(label)
        self._sections.append(label)
        try:
            yield now_open
        finally:
            self._sections.pop()
            imgui.PopID()
            if now_open:
                imgui.Dummy((0, self.px(4)))

    def show_section(self, label: str) -> None:
        """Open a section and bring it into view in the next frame."""
        self.open_sections[label] = True
        self.scroll_to = label

    # Menus

    @contextmanager
    def menu_bar(self) -> Iterator[None]:
        """The menu bar at the top."""
        imgui.BeginMainMenuBar()
        try:
            yield
        finally:
            imgui.EndMainMenuBar()

    @contextmanager
    def menu(self, label: str) -> Iterator[bool]:
        """A menu or submenu; yields whether it is open."""
        is_open = imgui.BeginMenu(label)
        self._record(label, "menu", text="open" if is_open else "closed")
        self._sections.append(label)
        try:
            yield is_open
        finally:
            self._sections.pop()
            if is_open:
                _close_by_escape()
                imgui.EndMenu()

    def menu_item(self, label: str, shortcut: str = "", checked: bool = False, enabled: bool = True) -> bool:
        """An entry of a menu; whether it was chosen."""
        chosen = imgui.MenuItem(label, shortcut, checked, enabled and not self._disabled)
        self._record(label, "item", enabled=enabled, text="checked" if checked else "")
        return bool(chosen)

    # Widgets

    def button(
        self, label: str, tip: str = "", *, enabled: bool = True, primary: bool = False, width: float = 0
    ) -> bool:
        """A button; whether it was pressed. A negative width leaves that much at the right, in pixels."""
        with self.disabled(not enabled):
            if primary:
                imgui.PushStyleColor(imgui.ImGuiCol_Button, self.colors.accent)
                imgui.PushStyleColor(imgui.ImGuiCol_ButtonHovered, self.colors.accent_hovered)
                imgui.PushStyleColor(imgui.ImGuiCol_ButtonActive, self.colors.accent_hovered)
                imgui.PushStyleColor(imgui.ImGuiCol_Text, self.colors.accent_ink)
            pressed = bool(imgui.Button(label, (width, 0)))
            if primary:
                imgui.PopStyleColor(4)
            self._record(label, "button")
        self.tip(tip)
        return pressed

    def checkbox(self, label: str, value: bool, tip: str = "") -> bool:
        """A box to tick; its new value."""
        _, value = imgui.Checkbox(label, value)
        self._record(label, "checkbox", text="on" if value else "off")
        self.tip(tip)
        return bool(value)

    def combo(self, label: str, value: Word, choices: Sequence[Word], tip: str = "", width: float = 0) -> Word:
        """One of several words; its new value. A width in pixels, or what the label leaves."""
        imgui.SetNextItemWidth(width or self._width_beside(label))
        is_open = imgui.BeginCombo(label, value, imgui.ImGuiComboFlags_HeightLargest)
        self._record(label, "combo", text=value)
        if is_open:
            self._sections.append(label)
            self._areas.append(self._areas[0])  # the list may be drawn outside its panel
            try:
                for choice in choices:
                    chosen = imgui.Selectable(choice, choice == value)
                    self._record(choice, "choice", text="chosen" if choice == value else "")
                    value = choice if chosen else value
            finally:
                self._areas.pop()
                self._sections.pop()
                _close_by_escape()
                imgui.EndCombo()
        else:
            self.tip(tip)
        return value

    def radio(self, choices: Sequence[Word], value: Word, tips: Sequence[str] = ()) -> Word:
        """One of a few words, side by side, on further lines where the panel ends; its new value."""
        right = imgui.GetCursorScreenPos()[0] + imgui.GetContentRegionAvail()[0]
        for number, choice in enumerate(choices):
            if number:
                needed = imgui.CalcTextSize(choice)[0] + imgui.GetFrameHeight() + self.px(16)
                if imgui.GetItemRectMax()[0] + needed < right:
                    imgui.SameLine()
            if imgui.RadioButton(choice, choice == value):
                value = choice
            self._record(choice, "choice", text="chosen" if choice == value else "")
            self.tip(tips[number] if tips else "")
        return value

    def number(
        self,
        label: str,
        value: float,
        low: float,
        high: float,
        tip: str = "",
        *,
        log: bool = False,
        whole: bool = False,
    ) -> float | None:
        """A slider with a box to type into, which takes values beyond the slider's ends; a new value, or None.

        A text that is no number is refused in place. Whole numbers keep their type in the display. A logarithmic
        slider from 0 has 0 at its left end, and six decades.
        """
        box = self.px(76)
        spacing = imgui.GetStyle().ItemInnerSpacing[0]
        width = max(self._width_beside(label) - box - spacing, self.px(40))
        imgui.SetNextItemWidth(width)
        flags = imgui.ImGuiSliderFlags_NoInput | imgui.ImGuiSliderFlags_NoRoundToFormat
        shown = share_of(min(max(value, low), high), low, high, log)
        changed, share = imgui.SliderFloat(f"##{label} slider", shown, 0.0, 1.0, "", flags)
        slid = value_at(share, low, high, log)
        self._record(label, "slider", low=low, high=high, log=log, text=f"{value:.6g}")
        self.tip(tip)
        result: float | None = None
        if changed:
            result = float(round(slid)) if whole else _rounded(slid)
            self._refused.pop(self._key(label), None)
        imgui.SameLine(0, spacing)
        text = self.text(label, f"{round(value)}" if whole else f"{value:.6g}", tip, width=box)
        if text is not None:
            try:
                typed = float(text)
                if not math.isfinite(typed):
                    raise ValueError
                result = typed
                self._refused.pop(self._key(label), None)
            except ValueError:
                self.refuse(label, f"{text!r} is no number")
        self.refusal(label)
        return result

    def text(self, label: str, value: str, tip: str = "", *, hint: str = "", width: float = 0) -> str | None:
        """A box to type into; the new text when Enter is pressed or the box is left, else None."""
        key = self._key(label)
        imgui.SetNextItemWidth(width or self._width_beside(label))
        shown = self._texts.get(key, value)
        _, typed = imgui.InputTextWithHint(label, hint, shown, imgui.ImGuiInputTextFlags_AutoSelectAll)
        self._record(label, "box", text=typed)
        self.tip(tip)
        if imgui.IsItemActive():
            self._texts[key] = typed
        if imgui.IsItemDeactivated():
            self._texts.pop(key, None)
            if typed != value and not imgui.IsKeyPressed(imgui.ImGuiKey_Escape):
                return str(typed)
        return None

    def live_text(self, label: str, value: str, tip: str = "", *, hint: str = "", focus: bool = False) -> str:
        """A box to type into; what it holds now. `focus` puts the keyboard there."""
        imgui.SetNextItemWidth(self._width_beside(label))
        if focus:
            imgui.SetKeyboardFocusHere()
        _, value = imgui.InputTextWithHint(label, hint, value, imgui.ImGuiInputTextFlags_AutoSelectAll)
        self._record(label, "box", text=value)
        self.tip(tip)
        return str(value)

    def row(self, label: str, chosen: bool) -> tuple[bool, bool]:
        """A row of a list; whether it was clicked, and whether twice in a row."""
        text = label.replace("##", "# #")  # which would hide the rest
        clicked = bool(imgui.Selectable(text, chosen, imgui.ImGuiSelectableFlags_AllowDoubleClick))
        self._record(label, "choice", text="chosen" if chosen else "")
        return clicked, clicked and bool(imgui.IsMouseDoubleClicked(0))

    def refuse(self, label: str, reason: str) -> None:
        """Say below the widget of this label why its new value was not taken; empty to say nothing any more."""
        if reason:
            self._refused[self._key(label)] = reason
        else:
            self._refused.pop(self._key(label), None)

    def accept_all(self) -> None:
        """Take back all refusals in this section."""
        here = self._key("")
        self._refused = {key: reason for key, reason in self._refused.items() if not key.startswith(here)}

    def refusal(self, label: str) -> None:
        """Show what `refuse` was told."""
        reason = self._refused.get(self._key(label))
        if reason:
            self.note(reason, "error")

    def progress(self, fraction: float, text: str) -> None:
        """A bar that fills."""
        imgui.ProgressBar(min(max(fraction, 0.0), 1.0), (-1, 0), text)

    @contextmanager
    def plot(self, label: str, height: float, flags: int) -> Iterator[bool]:
        """A plot as wide as the panel; yields whether there is something to draw on."""
        clear = (0, 0, 0, 0)
        colors = {
            implot.ImPlotCol_FrameBg: clear,
            implot.ImPlotCol_PlotBg: self.colors.ground,
            implot.ImPlotCol_PlotBorder: self.colors.border,
            implot.ImPlotCol_LegendBg: clear,
            implot.ImPlotCol_LegendBorder: clear,
            implot.ImPlotCol_AxisGrid: self.colors.border,
            implot.ImPlotCol_AxisTick: clear,
        }
        for index, color in colors.items():
            implot.PushStyleColor(index, color)
        is_drawn = bool(implot.BeginPlot(f"##{label}", (-1, self.px(height)), flags))
        try:
            yield is_drawn
        finally:
            if is_drawn:
                implot.EndPlot()
            implot.PopStyleColor(len(colors))
            self._record(label, "plot")

    # Text and space

    def note(self, text: str, kind: Literal["ink", "muted", "error", "good", "source", "target"] = "muted") -> None:
        """Text that wraps at the panel's edge."""
        imgui.PushStyleColor(imgui.ImGuiCol_Text, getattr(self.colors, kind))
        imgui.PushTextWrapPos(0)
        imgui.TextUnformatted(text)
        imgui.PopTextWrapPos()
        imgui.PopStyleColor()

    def heading(self, text: str, color: Color | None = None) -> None:
        """A title inside a section, with a line."""
        imgui.PushStyleColor(imgui.ImGuiCol_Text, color or self.colors.muted)
        imgui.SeparatorText(text)
        imgui.PopStyleColor()

    def separator(self) -> None:
        """A line across."""
        imgui.Separator()

    def beside(self, spacing: float = -1) -> None:
        """Put the next widget on the same line."""
        imgui.SameLine(0, spacing)

    def beside_if_fits(self, label: str) -> None:
        """Put the next button or checkbox on the same line where there is room for it."""
        right = imgui.GetCursorScreenPos()[0] + imgui.GetContentRegionAvail()[0]
        if imgui.GetItemRectMax()[0] + imgui.CalcTextSize(label)[0] + self.px(48) < right:
            imgui.SameLine()

    def tip(self, text: str) -> None:
        """A tooltip for the widget before; also where it is disabled."""
        if text and imgui.IsItemHovered(imgui.ImGuiHoveredFlags_AllowWhenDisabled | imgui.ImGuiHoveredFlags_DelayShort):
            imgui.BeginTooltip()
            imgui.PushTextWrapPos(self.px(340))
            imgui.TextUnformatted(text)
            imgui.PopTextWrapPos()
            imgui.EndTooltip()

    def record(
        self,
        label: str,
        kind: Kind,
        rect: Rect,
        low: float = 0.0,
        high: float = 0.0,
        text: str = "",
        log: bool = False,
    ) -> None:
        """Remember something that was drawn without these methods."""
        section, grab = "/".join(self._sections[1:]), imgui.GetStyle().GrabMinSize
        usable = not self._disabled
        self._drawn.append(Widget(label, kind, rect, self._areas[-1], section, usable, low, high, log, text, grab))

    def _record(
        self,
        label: str,
        kind: Kind,
        *,
        enabled: bool = True,
        low: float = 0.0,
        high: float = 0.0,
        log: bool = False,
        text: str = "",
    ) -> None:
        rect = (*imgui.GetItemRectMin(), *imgui.GetItemRectMax())
        usable = enabled and not self._disabled
        self._drawn.append(
            Widget(
                label,
                kind,
                rect,
                self._areas[-1],
                "/".join(self._sections[1:]),
                usable,
                low,
                high,
                log,
                text,
                imgui.GetStyle().GrabMinSize if kind == "slider" else 0.0,
            )
        )

    def _keep_scroll(self, name: str) -> None:
        """Remember how far the present window was scrolled; new ones, and a new context, start from there."""
        if self.capturing or name not in self._scrolls:
            imgui.SetScrollY(self._scrolls.setdefault(name, 0.0))
        else:
            self._scrolls[name] = imgui.GetScrollY()

    def _key(self, label: str) -> str:
        return "/".join([*self._sections, label])

    def _width_beside(self, label: str) -> float:
        """What the panel leaves beside a label, which all have the same room."""
        room = max(imgui.CalcTextSize(label.partition("##")[0])[0] + self.px(8), self.px(104))
        return max(float(imgui.GetContentRegionAvail()[0] - room), self.px(60))


def share_of(value: float, low: float, high: float, log: bool) -> float:
    """Where on a slider from `low` to `high` a value is, 0 to 1."""
    if not log:
        return (value - low) / (high - low)
    if low > 0:
        return math.log(value / low) / math.log(high / low)
    if value <= 0:
        return 0.0
    return _ZERO_SHARE + (1 - _ZERO_SHARE) * max(0.0, 1 + math.log10(value / high) / _DECADES)


def value_at(share: float, low: float, high: float, log: bool) -> float:
    """The value at a place of a slider: the inverse of `share_of`."""
    if not log:
        return low + share * (high - low)
    if low > 0:
        return float(low * (high / low) ** share)
    if share < _ZERO_SHARE / 2:
        return 0.0
    return float(high * 10 ** (_DECADES * (max(share, _ZERO_SHARE) - 1) / (1 - _ZERO_SHARE)))


def _close_by_escape() -> None:
    """Close the menu or the list that is open; ImGui does so only with keyboard navigation."""
    if imgui.IsKeyPressed(imgui.ImGuiKey_Escape, False):
        imgui.CloseCurrentPopup()


def _rounded(value: float) -> float:
    """Three digits: what a slider is good for."""
    return float(f"{value:.3g}")
