"""The menu bar."""

from pathlib import Path
from typing import Any

import polyscope.imgui as imgui

from abfm import Parameters
from abfm_viewer.appearance import colormaps
from abfm_viewer.appearance.abbreviation import cut
from abfm_viewer.document.document import LAYOUTS, THEMES
from abfm_viewer.scene.sample_textures import SampleTextures
from abfm_viewer.session.session import Session
from abfm_viewer.session.session_files import SessionFiles
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.window import samples_menu
from abfm_viewer.window.action import Action
from abfm_viewer.window.actions import Actions

UI_SCALES = (1.0, 1.25, 1.5, 2.0)
_LONGEST_PATH = 60

_INITIAL = Parameters()


def draw(ui: Ui, actions: Actions, textures: SampleTextures) -> None:
    def draw_samples(ui: Ui, actions: Actions) -> None:
        samples_menu.draw(ui, actions.context.files, textures)

    menus = {"File": _file, "Edit": _edit, "View": _view, "Samples": draw_samples, "Help": _help}
    with ui.menu_bar():
        for label, draw_menu in menus.items():
            with ui.menu(label) as is_open:
                if is_open:
                    draw_menu(ui, actions)
        _title(ui, actions.context.session)


def _title(ui: Ui, session: Session) -> None:
    """What is open, at the right of the menu bar, where there is room for it."""
    room = float(imgui.GetContentRegionAvail()[0]) - ui.px(16)
    title = cut(session.title, room, lambda text: float(imgui.CalcTextSize(text)[0]))
    width = float(imgui.CalcTextSize(title)[0])
    imgui.SetCursorPosX(imgui.GetCursorPosX() + max(room - width, 0.0))
    ui.note(title, "ink" if session.unsaved else "muted")
    if session.unsaved:
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
        if ui.menu_item(label):
            ui.show_tab("Export")
    imgui.Separator()
    _item(ui, "Quit", actions.quit)


def _recent(ui: Ui, files: SessionFiles) -> None:
    with ui.menu("Recent") as is_open:
        if not is_open:
            return
        recent = files.recent()
        for path in recent:
            if ui.menu_item(_short(path)):
                files.open(path)
        if not recent:
            ui.menu_item("no files yet", enabled=False)
        imgui.Separator()
        if ui.menu_item("Clear recent", enabled=bool(recent)):
            files.forget_recent()


def _edit(ui: Ui, actions: Actions) -> None:
    history = actions.context.session.history
    for label, action, what in (("Undo", actions.undo, history.undo_label), ("Redo", actions.redo, history.redo_label)):
        if ui.menu_item(label, f"{what}   {action.hint}" if what else action.hint, enabled=bool(what)):
            action.do()
    imgui.Separator()
    session = actions.context.session
    if ui.menu_item("Reset to defaults", enabled=session.parameters != _INITIAL):
        session.reset_parameters()


def _view(ui: Ui, actions: Actions) -> None:
    session = actions.context.session
    view = session.view
    for theme in THEMES:
        keys = actions.switch_theme.hint if theme != view.theme else ""
        if ui.menu_item(f"{theme.capitalize()} theme", keys, checked=view.theme == theme):
            session.set_view("change the theme", theme=theme)
    _choices(ui, session, "UI scale", "ui_scale", {f"{scale:g}": scale for scale in UI_SCALES})
    imgui.Separator()
    _choices(ui, session, "Layout", "layout", {name: name for name in LAYOUTS})
    _choices(ui, session, "Color map", "colormap", {name: name for name in ("automatic", *colormaps.NAMES)})
    for label, name, shown in (("Isolines", "isolines", view.isolines), ("Color bar", "color_bar", view.color_bar)):
        if ui.menu_item(label, checked=shown):
            session.set_view(f"{'hide' if shown else 'show'} the {label.lower()}", "", **{name: not shown})
    _item(ui, "Wireframe", actions.view.wireframe, view.wireframe)
    _item(ui, "Flat shading", actions.view.flat, view.flat)
    if ui.menu_item("Flow after a match", checked=view.flow_after_match):
        session.switch_flow_after_match()
    ui.tip("A match that has ended shows its flow, by streaks or arrows, and plays it once.")
    imgui.Separator()
    _surfaces(ui, actions)
    with ui.menu("Look from") as is_open:
        for axis, action in actions.view.axes.items() if is_open else ():
            _item(ui, axis, action)
    _item(ui, "Reset camera", actions.view.reset)


def _surfaces(ui: Ui, actions: Actions) -> None:
    """Which of them are shown."""
    view = actions.context.session.view
    with ui.menu("Surfaces") as is_open:
        if not is_open:
            return
        for name in view.surfaces:
            if ui.menu_item(name, checked=name in view.shown_surfaces):
                actions.view.hide_or_show(name)
        imgui.Separator()
        _item(ui, "Show all", actions.view.show_all)


def _choices(ui: Ui, session: Session, label: str, name: str, choices: dict[str, Any]) -> None:
    """A submenu of which one entry is chosen."""
    with ui.menu(label) as is_open:
        for choice, value in choices.items() if is_open else ():
            if ui.menu_item(choice, checked=getattr(session.view, name) == value):
                session.set_view(f"change the {label.replace('UI', 'window').lower()}", "", **{name: value})


def _help(ui: Ui, actions: Actions) -> None:
    _item(ui, "Shortcuts", actions.show_shortcuts)
    if ui.menu_item("Messages"):
        actions.show_messages()
    if ui.menu_item("About"):
        actions.show_about()


def _item(ui: Ui, label: str, action: Action, checked: bool = False) -> None:
    if ui.menu_item(label, action.hint, checked):
        action.do()


def _short(path: Path) -> str:
    """A path that fits in a menu: ~ for the user's own folder, and the middle left out."""
    text, home = str(path), str(Path.home())
    if text.startswith(f"{home}/"):
        text = f"~{text[len(home) :]}"
    return text if len(text) <= _LONGEST_PATH else f"{text[:15]}...{text[-_LONGEST_PATH + 18 :]}"
