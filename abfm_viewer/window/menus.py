"""The menu bar."""

from pathlib import Path
from typing import Any

import polyscope.imgui as imgui

from abfm import Parameters
from abfm_viewer.appearance import colormaps
from abfm_viewer.appearance.abbreviation import cut
from abfm_viewer.document.document import LAYOUTS, THEMES
from abfm_viewer.session.session import Session
from abfm_viewer.session.session_files import SessionFiles
from abfm_viewer.widgets.popups import menu, menu_bar, menu_item
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.window import samples_menu
from abfm_viewer.window.action import Action
from abfm_viewer.window.actions import Actions
from abfm_viewer.window.samples_menu import SampleTextures

UI_SCALES = (1.0, 1.25, 1.5, 2.0)
_LONGEST_PATH = 60

_INITIAL = Parameters()


def draw(ui: Ui, actions: Actions, textures: SampleTextures) -> None:
    def draw_samples(ui: Ui, actions: Actions) -> None:
        samples_menu.draw(ui, actions.context.files, textures)

    menus = {"File": _file, "Edit": _edit, "View": _view, "Samples": draw_samples, "Help": _help}
    with menu_bar():
        for label, draw_menu in menus.items():
            with menu(ui, label) as is_open:
                if is_open:
                    draw_menu(ui, actions)
        _title(ui, actions.context.session)


def _title(ui: Ui, session: Session) -> None:
    """Draw what is open at the right of the menu bar, where there is room for it."""
    room = float(imgui.GetContentRegionAvail()[0]) - ui.px(16)
    title = cut(session.saves.title, room, ui.text_width)
    imgui.SetCursorPosX(imgui.GetCursorPosX() + max(room - ui.text_width(title), 0.0))
    ui.note(title, "ink" if session.saves.unsaved else "muted")
    if session.saves.unsaved:
        ui.tip("Not saved since the last change (Ctrl+S).")


def _file(ui: Ui, actions: Actions) -> None:
    _item(ui, "Open mesh...", actions.open_mesh)
    _item(ui, "Open project...", actions.open_project)
    _recent(ui, actions.context.files)
    imgui.Separator()
    _item(ui, "Save project", actions.save)
    _item(ui, "Save project as...", actions.save_as)
    imgui.Separator()
    for label in ("Export picture...", "Export movie...", "Export data..."):
        if menu_item(ui, label):
            ui.open_tab = "Export"
    imgui.Separator()
    _item(ui, "Quit", actions.quit)


def _recent(ui: Ui, files: SessionFiles) -> None:
    with menu(ui, "Recent") as is_open:
        if not is_open:
            return
        recent = files.recent()
        for path in recent:
            if menu_item(ui, _short(path)):
                files.open(path)
        if not recent:
            menu_item(ui, "no files yet", enabled=False)
        imgui.Separator()
        if menu_item(ui, "Clear recent", enabled=bool(recent)):
            files.forget_recent()


def _edit(ui: Ui, actions: Actions) -> None:
    session = actions.context.session
    undo = (actions.undo, session.editor.undo_label)
    redo = (actions.redo, session.editor.redo_label)
    for label, (action, what) in {"Undo": undo, "Redo": redo}.items():
        hint = f"{what}   {action.hint}" if what else action.hint
        if menu_item(ui, label, hint, enabled=bool(what)):
            action.do()
    imgui.Separator()
    if menu_item(ui, "Reset to defaults", enabled=session.parameters != _INITIAL):
        session.editor.reset_parameters()


def _view(ui: Ui, actions: Actions) -> None:
    session = actions.context.session
    view = session.view
    for theme in THEMES:
        keys = actions.switch_theme.hint if theme != view.theme else ""
        if menu_item(ui, f"{theme.capitalize()} theme", keys, checked=view.theme == theme):
            session.editor.set_view("change the theme", theme=theme)
    _choices(ui, session, "UI scale", "ui_scale", {f"{scale:g}": scale for scale in UI_SCALES})
    imgui.Separator()
    _choices(ui, session, "Layout", "layout", {name: name for name in LAYOUTS})
    maps = ("automatic", *colormaps.NAMES)
    _choices(ui, session, "Color map", "colormap", {name: name for name in maps})
    for label, name in (("Isolines", "isolines"), ("Color bar", "color_bar")):
        shown = getattr(view, name)
        if menu_item(ui, label, checked=shown):
            what = f"{'hide' if shown else 'show'} the {label.lower()}"
            session.editor.set_view(what, "", **{name: not shown})
    _item(ui, "Wireframe", actions.view.wireframe, view.wireframe)
    _item(ui, "Flat shading", actions.view.flat, view.flat)
    if menu_item(ui, "Flow after a match", checked=view.flow_after_match):
        session.switch_flow_after_match()
    ui.tip("A match that has ended shows its flow, by streaks or arrows, and plays it once.")
    imgui.Separator()
    _surfaces(ui, actions)
    with menu(ui, "Look from") as is_open:
        for axis, action in actions.view.axes.items() if is_open else ():
            _item(ui, axis, action)
    _item(ui, "Reset camera", actions.view.reset)


def _surfaces(ui: Ui, actions: Actions) -> None:
    """Draw the menu of those that are shown."""
    view = actions.context.session.view
    with menu(ui, "Surfaces") as is_open:
        if not is_open:
            return
        for name in view.surfaces:
            if menu_item(ui, name, checked=name in view.shown_surfaces):
                actions.view.hide_or_show(name)
        imgui.Separator()
        _item(ui, "Show all", actions.view.show_all)


def _choices(ui: Ui, session: Session, label: str, name: str, choices: dict[str, Any]) -> None:
    """Draw a submenu of which one entry is chosen."""
    what = f"change the {label.replace('UI', 'window').lower()}"
    with menu(ui, label) as is_open:
        for choice, value in choices.items() if is_open else ():
            if menu_item(ui, choice, checked=getattr(session.view, name) == value):
                session.editor.set_view(what, "", **{name: value})


def _help(ui: Ui, actions: Actions) -> None:
    _item(ui, "Shortcuts", actions.show_shortcuts)
    if menu_item(ui, "Messages"):
        actions.show_messages()
    if menu_item(ui, "About"):
        actions.show_about()


def _item(ui: Ui, label: str, action: Action, checked: bool = False) -> None:
    if menu_item(ui, label, action.hint, checked):
        action.do()


def _short(path: Path) -> str:
    """Return a path that fits in a menu: ~ for the user's folder, and the middle left out."""
    text, home = str(path), str(Path.home())
    if text.startswith(f"{home}/"):
        text = f"~{text[len(home) :]}"
    return text if len(text) <= _LONGEST_PATH else f"{text[:15]}...{text[-_LONGEST_PATH + 18 :]}"
