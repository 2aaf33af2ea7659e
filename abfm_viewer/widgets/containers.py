"""What widgets are drawn in: windows, dialogs, sections, menus and plots, with a record of what is where.

Everything that opens something is a context manager, so that an error inside leaves ImGui's stacks whole.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import Any

import polyscope.imgui as imgui
import polyscope.implot as implot

from abfm_viewer.appearance import theme
from abfm_viewer.appearance.theme import Palette
from abfm_viewer.document.document import Theme
from abfm_viewer.widgets.widget_record import Rect, Widget, WidgetKind, WidgetRecord

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


class Containers:
    """Opens and closes what holds widgets; `scale` are the pixels of a length of 1.

    `hidden_heights` are those of the parts of windows and children, by their names, that must be scrolled to.

    While it is `capturing`, frames are drawn for a picture: polyscope does that in a new ImGui context, which remembers
    nothing.
    """

    def __init__(self) -> None:
        self.scale = 1.0
        self.colors: Palette = theme.LIGHT
        self.open_sections: dict[str, bool] = {}
        self.open_tab = ""
        self.capturing = False
        self._widget_record = WidgetRecord()
        self._scrolls: dict[str, float] = {}
        self.hidden_heights: dict[str, float] = {}

    @property
    def widgets(self) -> list[Widget]:
        """Those of the latest whole frame."""
        return self._widget_record.latest

    def begin_frame(self, scale: float, name: Theme) -> None:
        self.scale, self.colors = scale, theme.palette(name)
        self._widget_record.begin_frame((0, 0, *imgui.GetIO().DisplaySize))

    def end_frame(self) -> None:
        self._widget_record.end_frame()

    def px(self, length: float) -> float:
        """A length in pixels, for one given at a scale of 1."""
        return length * self.scale

    @contextmanager
    def window(self, name: str, rect: Rect) -> Iterator[None]:
        """A fixed panel."""
        imgui.SetNextWindowPos(rect[:2])
        imgui.SetNextWindowSize((rect[2] - rect[0], rect[3] - rect[1]))
        imgui.Begin(name, _WINDOW)
        with self._inside(imgui.End, self._widget_record.area(rect)):
            self._keep_scroll(name)
            yield

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
        with self._inside(imgui.End, self._widget_record.area(window_rect()), self._widget_record.section(title)):
            yield

    @contextmanager
    def child(self, name: str, height: float, border: bool = True, shrinks: bool = False) -> Iterator[None]:
        """A part of a panel that scrolls by itself; a negative height leaves that much below it.

        One that `shrinks` is as low as what is in it. Others leave room for a scroll bar also where there is none: what
        is in them stays where it is when more comes.
        """
        flags = imgui.ImGuiChildFlags_Borders if border else imgui.ImGuiChildFlags_None
        if shrinks:
            flags |= imgui.ImGuiChildFlags_AutoResizeY
            imgui.SetNextWindowSizeConstraints((0, 0), (imgui.GetContentRegionAvail()[0], height))
        else:
            padding = 2 * imgui.GetStyle().WindowPadding[0] if border else 0
            width = imgui.GetContentRegionAvail()[0] - imgui.GetStyle().ScrollbarSize - self.px(4) - padding
            imgui.SetNextWindowContentSize((width, 0))
        imgui.BeginChild(name, (0, 0 if shrinks else height), flags)
        with self._inside(imgui.EndChild, self._widget_record.area(window_rect())):
            self._keep_scroll(self._widget_record.path(name))
            yield

    @contextmanager
    def disabled(self, condition: bool = True) -> Iterator[None]:
        """Grey widgets that do nothing; paler still in what is disabled already, as the window behind a dialog is."""
        style = imgui.GetStyle()
        paler = condition and not self._widget_record.enabled
        imgui.PushStyleVar(imgui.ImGuiStyleVar_Alpha, style.Alpha * (style.DisabledAlpha if paler else 1.0))
        imgui.BeginDisabled(condition)
        with self._inside(imgui.PopStyleVar, self._widget_record.disabled(condition)):
            try:
                yield
            finally:
                imgui.EndDisabled()

    @contextmanager
    def group(self, name: str) -> Iterator[None]:
        """Widgets whose labels may also be found elsewhere: `name` tells them apart, also for the Driver."""
        imgui.PushID(name)
        with self._inside(imgui.PopID, self._widget_record.section(name)):
            yield

    @contextmanager
    def section(self, label: str, opened: bool = True) -> Iterator[bool]:
        """A collapsible part of the panel; yields whether it is open."""
        is_open = self.open_sections.setdefault(label, opened)
        imgui.SetNextItemOpen(is_open, imgui.ImGuiCond_Always)
        imgui.PushStyleColor(imgui.ImGuiCol_Text, self.colors.ink)
        now_open = imgui.CollapsingHeader(label)
        imgui.PopStyleColor()
        self.record(label, "section", text="open" if now_open else "closed")
        self.open_sections[label] = now_open
        try:
            with self.group(label):
                yield now_open
        finally:
            if now_open:
                imgui.Dummy((0, self.px(4)))

    def tabs(self, name: str, labels: Sequence[str]) -> str:
        """A row of tabs, as wide as the panel; which one is open, at first the first."""
        if self.open_tab not in labels:
            self.open_tab = labels[0]
        gap = self.px(2)
        widths = [float(imgui.CalcTextSize(label)[0]) for label in labels]
        padding = (imgui.GetContentRegionAvail()[0] - gap * (len(labels) - 1) - sum(widths)) / len(labels)
        with self.group(name):
            for number, (label, width) in enumerate(zip(labels, widths, strict=True)):
                if number and padding > 0:
                    imgui.SameLine(0, gap)
                if self._tab(label, width + max(padding, self.px(2)), label == self.open_tab):
                    self.open_tab = label
        return self.open_tab

    def _tab(self, label: str, width: float, is_open: bool) -> bool:
        """One of the tabs; whether it was clicked."""
        ground = self.colors.pressed if is_open else self.colors.panel
        imgui.PushStyleColor(imgui.ImGuiCol_Button, ground)
        imgui.PushStyleColor(imgui.ImGuiCol_Text, self.colors.ink if is_open else self.colors.muted)
        imgui.PushStyleVarX(imgui.ImGuiStyleVar_FramePadding, 0)
        clicked = bool(imgui.Button(label, (width, 0)))
        imgui.PopStyleVar()
        imgui.PopStyleColor(2)
        (left, _), (right, bottom) = imgui.GetItemRectMin(), imgui.GetItemRectMax()
        line = self.colors.accent if is_open else self.colors.border
        canvas, height = imgui.GetWindowDrawList(), self.px(2 if is_open else 1)
        canvas.AddRectFilled((left, bottom - height), (right, bottom), imgui.GetColorU32(line))
        self.record(label, "tab", text="open" if is_open else "closed")
        return clicked

    def show_tab(self, label: str) -> None:
        """Open a tab from the next frame on."""
        self.open_tab = label

    @contextmanager
    def menu_bar(self) -> Iterator[None]:
        imgui.BeginMainMenuBar()
        with self._inside(imgui.EndMainMenuBar):
            yield

    @contextmanager
    def menu(self, label: str) -> Iterator[bool]:
        """A menu or submenu; yields whether it is open."""
        is_open = imgui.BeginMenu(label)
        self.record(label, "menu", text="open" if is_open else "closed")
        try:
            with self._widget_record.section(label):
                yield is_open
        finally:
            if is_open:
                close_by_escape()
                imgui.EndMenu()

    def menu_item(self, label: str, shortcut: str = "", checked: bool = False, enabled: bool = True) -> bool:
        """An entry of a menu; whether it was chosen."""
        chosen = imgui.MenuItem(label, shortcut, checked, enabled and self._widget_record.enabled)
        self.record(label, "item", enabled=enabled, text="checked" if checked else "")
        return bool(chosen)

    @contextmanager
    def plot(self, label: str, height: float, flags: int) -> Iterator[bool]:
        """A plot as wide as the panel, as high as so many pixels; yields whether there is something to draw on."""
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
        is_drawn = bool(implot.BeginPlot(f"##{label}", (-1, height), flags))
        try:
            yield is_drawn
        finally:
            if is_drawn:
                implot.EndPlot()
            implot.PopStyleColor(len(colors))
            self.record(label, "plot")

    @contextmanager
    def _outlined(self) -> Iterator[None]:
        """An edge around what is ticked or not, which else would hardly be seen."""
        imgui.PushStyleVar(imgui.ImGuiStyleVar_FrameBorderSize, max(1.0, self.scale))
        imgui.PushStyleColor(imgui.ImGuiCol_Border, (*self.colors.muted[:3], 0.7))
        try:
            yield
        finally:
            imgui.PopStyleColor()
            imgui.PopStyleVar()

    def record(
        self, label: str, kind: WidgetKind, rect: Rect | None = None, enabled: bool = True, **details: Any
    ) -> None:
        """Remember what was drawn, with attributes of `Widget`; without a rectangle, ImGui's latest item."""
        if kind == "slider":
            details["grab"] = imgui.GetStyle().GrabMinSize
        rect = rect or (*imgui.GetItemRectMin(), *imgui.GetItemRectMax())
        self._widget_record.add(label, kind, rect, enabled, **details)

    @contextmanager
    def _inside(self, end: Callable[[], object], *parts: AbstractContextManager[None]) -> Iterator[None]:
        """A block in parts of the record that ends for ImGui, too, whatever happens in it."""
        with ExitStack() as stack:
            stack.callback(end)
            for part in parts:
                stack.enter_context(part)
            yield

    def _keep_scroll(self, name: str) -> None:
        """Remember how far the present window was scrolled; new ones, and a new context, start from there."""
        self.hidden_heights[name] = imgui.GetScrollMaxY()
        if self.capturing or name not in self._scrolls:
            imgui.SetScrollY(self._scrolls.setdefault(name, 0.0))
        else:
            self._scrolls[name] = imgui.GetScrollY()


def close_by_escape() -> None:
    """Close the menu or the list that is open; ImGui does so only with keyboard navigation."""
    if imgui.IsKeyPressed(imgui.ImGuiKey_Escape, False):
        imgui.CloseCurrentPopup()


def window_rect() -> Rect:
    left, top = imgui.GetWindowPos()
    return left, top, left + imgui.GetWindowWidth(), top + imgui.GetWindowHeight()
