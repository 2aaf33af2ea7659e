"""Containers of widgets: windows, dialogs, cards, sections, tabs and menus.

Containers are context managers, so that an error inside cannot corrupt ImGui's stacks.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Literal

import polyscope.imgui as imgui

from abfm_viewer.appearance.theme import Color
from abfm_viewer.widgets.toolkit import Pushed, Ui, close_by_escape
from abfm_viewer.widgets.widget_record import Rect

Fits = Literal["exactly", "at most", "at least"]
_HEIGHT_MAX = 1e6  # pixels
_PLAIN_FLAGS = imgui.ImGuiWindowFlags_NoMove | imgui.ImGuiWindowFlags_NoSavedSettings
_WINDOW = (
    _PLAIN_FLAGS
    | imgui.ImGuiWindowFlags_NoDecoration
    | imgui.ImGuiWindowFlags_NoBringToFrontOnFocus
)
_DIALOG = _PLAIN_FLAGS | imgui.ImGuiWindowFlags_NoCollapse | imgui.ImGuiWindowFlags_NoResize
_CARD = (
    _DIALOG
    | imgui.ImGuiWindowFlags_NoTitleBar
    | imgui.ImGuiWindowFlags_AlwaysAutoResize
    | imgui.ImGuiWindowFlags_NoFocusOnAppearing
)


@contextmanager
def _ended(
    ui: Ui, end: Callable[[], object], section: str = "", rect: Rect | None = None
) -> Iterator[None]:
    """Call ``end`` after the block, also if it raises an error.

    The widgets of the block are recorded in the given section. They lie in the area ``rect``, by
    default that of the current window.
    """
    try:
        (left, top), width = imgui.GetWindowPos(), imgui.GetWindowWidth()
        area = rect or (left, top, left + width, top + imgui.GetWindowHeight())
        with ui.record.within(section, area):
            yield
    finally:
        end()


@contextmanager
def window(ui: Ui, name: str, rect: Rect, scrolls: bool = False) -> Iterator[None]:
    imgui.SetNextWindowPos(rect[:2])
    imgui.SetNextWindowSize((rect[2] - rect[0], rect[3] - rect[1]))
    imgui.Begin(name, _WINDOW & ~imgui.ImGuiWindowFlags_NoScrollbar if scrolls else _WINDOW)
    with _ended(ui, imgui.End, rect=rect):
        _keep_scroll(ui, name)
        yield


@contextmanager
def dialog(
    ui: Ui, title: str, width: float, height: float = 0, highest: float = 0
) -> Iterator[None]:
    """Draw a window over a dimmed background; without a height it fits its contents.

    If the contents change, ``highest`` is the height that leaves the top edge in its place.
    """
    display = imgui.GetIO().DisplaySize
    imgui.SetNextWindowPos((0, 0))
    imgui.SetNextWindowSize(tuple(display))
    with Pushed({imgui.ImGuiCol_WindowBg: (0, 0, 0, 0.35)}):
        imgui.Begin("backdrop", _WINDOW & ~imgui.ImGuiWindowFlags_NoBringToFrontOnFocus)
        imgui.End()
    size = (min(ui.px(width), 0.96 * display[0]), min(ui.px(height), 0.92 * display[1]))
    top = max(display[1] - ui.px(highest), 0.08 * display[1]) / 2 if highest else display[1] / 2
    pivot = 0.5, 0.0 if highest else 0.5
    imgui.SetNextWindowPos((display[0] / 2, top), imgui.ImGuiCond_Always, pivot)
    flags = _DIALOG
    if height:
        imgui.SetNextWindowSize(size)
    else:
        imgui.SetNextWindowSizeConstraints((size[0], 0), (size[0], 0.92 * display[1]))
        flags |= imgui.ImGuiWindowFlags_AlwaysAutoResize
    if not is_popup_open():  # a focused window closes its lists
        imgui.SetNextWindowFocus()
    imgui.Begin(title, flags)
    with _ended(ui, imgui.End, title):
        yield


@contextmanager
def card(
    ui: Ui, name: str, place: tuple[float, float, float], color: Color, highest: float
) -> Iterator[None]:
    """Draw an opaque window with a coloured edge, without focus, as high as its contents.

    ``place`` is its left side, bottom and width, and ``highest`` its maximum height, in pixels.
    """
    left, bottom, width = place
    imgui.SetNextWindowPos((left, bottom), imgui.ImGuiCond_Always, (0, 1))
    imgui.SetNextWindowSizeConstraints((width, 0), (width, max(highest, ui.px(40))))
    imgui.SetNextWindowBgAlpha(1)  # also behind a dialog
    border, rounding = max(1.0, 2 * ui.scale), ui.px(6)
    sizes = {
        imgui.ImGuiStyleVar_WindowBorderSize: border,
        imgui.ImGuiStyleVar_WindowRounding: rounding,
    }
    with Pushed({imgui.ImGuiCol_Border: color}, sizes):
        imgui.Begin(f"{name}##card", _CARD)
    with _ended(ui, imgui.End), ui.group(name):
        yield


@contextmanager
def child(
    ui: Ui,
    name: str,
    size: float | tuple[float, float],
    border: bool = True,
    fits: Fits = "exactly",
) -> Iterator[None]:
    """Draw a part of a panel that scrolls separately.

    ``size`` is the height, or width and height. A negative height leaves that much space below the
    part. If ``fits`` is "at most" or "at least",
    the height is that of the contents within this limit.
    """
    width, height = size if isinstance(size, tuple) else (0.0, size)
    flags = imgui.ImGuiChildFlags_Borders if border else imgui.ImGuiChildFlags_None
    style, room = imgui.GetStyle(), width or imgui.GetContentRegionAvail()[0]
    if fits != "exactly":
        flags |= imgui.ImGuiChildFlags_AutoResizeY
        lowest, highest = (height, _HEIGHT_MAX) if fits == "at least" else (0.0, height)
        imgui.SetNextWindowSizeConstraints((0, lowest), (room, highest))
    else:  # contents must not move when a scroll bar appears
        padding = 2 * style.WindowPadding[0] if border else 0
        imgui.SetNextWindowContentSize((room - style.ScrollbarSize - ui.px(4) - padding, 0))
    imgui.BeginChild(name, (width, height if fits == "exactly" else 0), flags)
    # a part of unlimited height does not scroll, but the part that contains it does
    outer = ui.record.areas[-1] if fits == "at least" else None
    with _ended(ui, imgui.EndChild, rect=outer):
        _keep_scroll(ui, ui.record.path(name))
        if not ui.listing:
            ui.heights[name] = float(imgui.GetWindowHeight())
        yield


def _keep_scroll(ui: Ui, name: str) -> None:
    """Store the scroll position of the current window, and restore it in a new ImGui context."""
    if ui.listing:
        return
    ui.hidden_heights[name] = imgui.GetScrollMaxY()
    if ui.capturing or name not in ui.scrolls:
        imgui.SetScrollY(ui.scrolls.setdefault(name, 0.0))
    else:
        ui.scrolls[name] = imgui.GetScrollY()


@contextmanager
def section(ui: Ui, label: str, opened: bool = True) -> Iterator[bool]:
    is_open = ui.open_sections.setdefault(label, opened)
    imgui.SetNextItemOpen(is_open, imgui.ImGuiCond_Always)
    with Pushed({imgui.ImGuiCol_Text: ui.colors.ink}):
        now_open = imgui.CollapsingHeader(label)
    if ui.record_item(label, "section", text="open" if now_open else "closed"):
        now_open = True
    ui.open_sections[label] = now_open
    try:
        with ui.group(label):
            yield now_open or ui.listing
    finally:
        if now_open:
            imgui.Dummy((0, ui.px(4)))


@contextmanager
def reserved(ui: Ui, lines: int, captions: int) -> Iterator[None]:
    """Draw the block, and reserve the height of some lines of widgets for it.

    Widgets below it then do not move. If captions are above widgets, reserve lines of text for them
    as well.
    """
    height = lines * imgui.GetFrameHeightWithSpacing()
    height += captions * imgui.GetTextLineHeightWithSpacing() * ui.captions_are_above
    begin = imgui.GetCursorPosY()
    yield
    rest = begin + height - imgui.GetCursorPosY() - imgui.GetStyle().ItemSpacing[1]
    if rest > 0:
        imgui.Dummy((0, rest))


def tabs(ui: Ui, name: str, labels: Sequence[str]) -> str:
    """Draw tabs across the panel; return the label of the open tab, initially the first one."""
    if ui.open_tab not in labels:
        ui.open_tab = labels[0]
    gap, colors = ui.px(2), ui.colors
    widths = [ui.text_width(label) for label in labels]
    room = imgui.GetContentRegionAvail()[0] - gap * (len(labels) - 1)
    padding = (room - sum(widths)) / len(labels)
    no_padding = {imgui.ImGuiStyleVar_FramePadding: (0, imgui.GetStyle().FramePadding[1])}
    with ui.group(name):
        for number, (label, width) in enumerate(zip(labels, widths, strict=True)):
            if number and padding > 0:
                ui.same_line(gap)
            is_open = label == ui.open_tab
            colors_of_tab = {
                imgui.ImGuiCol_Button: colors.pressed if is_open else colors.panel,
                imgui.ImGuiCol_Text: colors.ink if is_open else colors.muted,
            }
            with Pushed(colors_of_tab, no_padding):
                clicked = imgui.Button(label, (width + max(padding, ui.px(2)), 0))
            (left, _), (right, bottom) = imgui.GetItemRectMin(), imgui.GetItemRectMax()
            line = imgui.GetColorU32(colors.accent if is_open else colors.border)
            top = bottom - ui.px(2 if is_open else 1)
            imgui.GetWindowDrawList().AddRectFilled((left, top), (right, bottom), line)
            if ui.record_item(label, "tab", text="open" if is_open else "closed") or clicked:
                ui.open_tab = label
    return ui.open_tab


def is_mouse_in(rect: Rect) -> bool:
    x, y = imgui.GetMousePos()
    return bool(rect[0] <= x < rect[2] and rect[1] <= y < rect[3])


def is_popup_open() -> bool:
    anywhere = imgui.ImGuiPopupFlags_AnyPopupId | imgui.ImGuiPopupFlags_AnyPopupLevel
    return bool(imgui.IsPopupOpen("", anywhere))


@contextmanager
def menu(ui: Ui, label: str) -> Iterator[bool]:
    if ui.listing:
        with ui.record.within(label):
            yield True
        return
    opened = imgui.BeginMenu(label)
    ui.record_item(label, "menu", text="open" if opened else "closed")
    try:
        with ui.record.within(label):
            yield opened
    finally:
        if opened:
            close_by_escape()
            imgui.EndMenu()


@contextmanager
def menu_button(ui: Ui, name: str, tip: str, enabled: bool) -> Iterator[bool]:
    """Draw a small button with an arrow, which opens a menu; yield whether the menu is open."""
    with ui.disabled(not enabled):
        if imgui.ArrowButton(name, imgui.ImGuiDir_Down):
            imgui.OpenPopup(f"{name} menu")
        opened = bool(imgui.IsPopupOpen(f"{name} menu"))
        ui.record_item(name, "menu", text="open" if opened else "closed", tip=tip)
        ui.tip("" if opened else tip)
    # the menu is below its button, and ends at the edge of a panel at the right of the window
    place, right = (imgui.GetItemRectMin()[0], imgui.GetItemRectMax()[1]), ui.record.areas[0][2]
    if is_right := place[0] > 0.5 * right:
        place = right - imgui.GetStyle().WindowPadding[0], place[1]
    imgui.SetNextWindowPos(place, imgui.ImGuiCond_Appearing, (float(is_right), 0))
    opened = bool(imgui.BeginPopup(f"{name} menu"))
    try:
        with ui.record.within(name, ui.record.areas[0]):
            yield opened
    finally:
        if opened:
            close_by_escape()
            imgui.EndPopup()


def menu_item(
    ui: Ui, label: str, shortcut: str = "", checked: bool = False, enabled: bool = True
) -> bool:
    chosen = imgui.MenuItem(label, shortcut, checked, enabled and ui.record.enabled)
    text = "checked" if checked else ""
    is_wanted = ui.record_item(label, "item", enabled=enabled, text=text, keys=shortcut)
    return bool(chosen) or is_wanted
