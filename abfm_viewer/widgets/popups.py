"""Menus and lists that open over the window."""

from collections.abc import Iterator
from contextlib import contextmanager

import polyscope.imgui as imgui

from abfm_viewer.widgets.toolkit import Ui, close_by_escape


def is_open() -> bool:
    """Return whether a menu or a list is open."""
    anywhere = imgui.ImGuiPopupFlags_AnyPopupId | imgui.ImGuiPopupFlags_AnyPopupLevel
    return bool(imgui.IsPopupOpen("", anywhere))


@contextmanager
def menu_bar() -> Iterator[None]:
    imgui.BeginMainMenuBar()
    try:
        yield
    finally:
        imgui.EndMainMenuBar()


@contextmanager
def menu(ui: Ui, label: str) -> Iterator[bool]:
    """Draw a menu or submenu in the block; yields whether it is open."""
    opened = imgui.BeginMenu(label)
    ui.remember(label, "menu", text="open" if opened else "closed")
    try:
        with ui.record.section(label):
            yield opened
    finally:
        if opened:
            close_by_escape()
            imgui.EndMenu()


def menu_item(
    ui: Ui, label: str, shortcut: str = "", checked: bool = False, enabled: bool = True
) -> bool:
    """Draw an entry of a menu; whether it was chosen."""
    chosen = imgui.MenuItem(label, shortcut, checked, enabled and ui.record.enabled)
    ui.remember(label, "item", enabled=enabled, text="checked" if checked else "")
    return bool(chosen)


def tile(ui: Ui, label: str, chosen: bool, size: tuple[float, float]) -> bool:
    """Draw an empty entry of a size in pixels, to be drawn on; whether it was chosen."""
    pressed = bool(imgui.Selectable(f"##{label}", chosen, imgui.ImGuiSelectableFlags_None, size))
    ui.remember(label, "item", text="checked" if chosen else "")
    return pressed
