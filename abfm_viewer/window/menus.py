"""The menu bar."""

from functools import partial
from pathlib import Path
from typing import Any

import polyscope.imgui as imgui

from abfm import Parameters
from abfm.pages import colormaps
from abfm_viewer.appearance.abbreviation import abbreviated
from abfm_viewer.dialogs import native_dialog
from abfm_viewer.document.document import APPEARANCE, LAYOUTS, THEMES
from abfm_viewer.document.keyboard import hint
from abfm_viewer.files.contents import is_named_as_frames
from abfm_viewer.panels import export
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.export_formats import PAGE
from abfm_viewer.panels.inputs import landmarks
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.containers import menu, menu_item
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.window import samples
from abfm_viewer.window.actions import Action, Actions

UI_SCALES = (1.0, 1.25, 1.5, 2.0)
_PATH_LENGTH_MAX = 60
_TABLES = (
    "Show the results of abfm batch or population as a table: choose population.npz, subjects.csv, "
    "summary.csv, or rows.json in the folder ledger. A folder can also be dropped on the window."
)
_NATIVE_TIP = "Open files in the dialog of the system. Saving uses the dialog of the app."
_FINER_TIP = (
    "Show the functions of a match on the finer mesh on which it was found, without streaks. "
    "Everything else stays on the mesh itself; clicks and drags also refer to it."
)


def draw(ui: Ui, actions: Actions) -> None:
    saves = actions.context.session.saves
    imgui.BeginMainMenuBar()
    try:
        draw_menus(ui, actions)
        # the name of the document at the right, abbreviated to fit
        available = float(imgui.GetContentRegionAvail()[0]) - ui.px(16)
        title = abbreviated(saves.title, available, ui.text_width)
        imgui.SetCursorPosX(imgui.GetCursorPosX() + max(available - ui.text_width(title), 0.0))
        ui.note(title, "ink" if saves.unsaved else "muted")
        if saves.unsaved:
            ui.tip(f"Not saved since the last change ({hint('save')}).")
    finally:
        imgui.EndMainMenuBar()


def draw_menus(ui: Ui, actions: Actions) -> None:
    menus = {"File": _file, "Edit": _edit, "View": _view, "Samples": _samples, "Help": _help}
    for label, draw_menu in menus.items():
        with menu(ui, label) as is_open:
            if is_open:
                draw_menu(ui, actions)


def _items(ui: Ui, entries: dict[str, Action]) -> None:
    for label, action in entries.items():
        if menu_item(ui, label, action.hint):
            action.do()


def _file(ui: Ui, actions: Actions) -> None:
    files = actions.context.files
    _items(ui, {"Open mesh...": actions.open_mesh, "Open project...": actions.open_project})
    if menu_item(ui, "Open batch or population..."):
        actions.context.open_table()
    ui.tip(_TABLES)
    _second_surface(ui, actions)
    with menu(ui, "Recent") as is_open:
        if is_open:
            recent = files.state.recent() if files.state else []
            for paths in recent:
                if menu_item(ui, _recent_label(paths)):
                    files.open_together(paths)
                ui.tip("\n".join(map(str, paths)) if len(paths) > 1 else "")
            if not recent:
                menu_item(ui, "no files yet", enabled=False)
            imgui.Separator()
            if menu_item(ui, "Clear recent", enabled=bool(recent)) and files.state:
                files.state.clear_recent()
            ui.tip("" if recent else "The list is empty.")
    imgui.Separator()
    _items(ui, {"Save project": actions.save, "Save project as...": actions.save_as})
    imgui.Separator()
    list_copies = actions.context.list_copies
    if menu_item(ui, "Recover unsaved work...", enabled=list_copies is not None) and list_copies:
        list_copies()
    _native_dialogs(ui, actions.context)
    imgui.Separator()
    _items(ui, {"Export...": actions.export})
    if menu_item(ui, "Page for a browser..."):
        export.open_dialog(actions.context, PAGE)
    imgui.Separator()
    _items(ui, {"Quit": actions.quit})


def _native_dialogs(ui: Ui, context: Context) -> None:
    preferences, available = context.preferences, not native_dialog.missing()
    is_on = preferences.now.native_dialogs and available
    if menu_item(ui, "Native file dialogs", checked=is_on, enabled=available):
        preferences.change(native_dialogs=not preferences.now.native_dialogs)
    ui.tip(_NATIVE_TIP if available else f"{_NATIVE_TIP}\n\n{native_dialog.missing()}.")


def _second_surface(ui: Ui, actions: Actions) -> None:
    context = actions.context
    if menu_item(ui, "Open second surface..."):
        context.open_second()
    ui.tip("Open surface B and register the first one, A, to it: a flow on B moves A's functions.")
    if menu_item(ui, "Open frames..."):
        context.open_frames()
    ui.tip("Open a function on the current mesh at several times; consecutive frames are matched.")
    has_second = len(context.session.document.surfaces) > 1
    if menu_item(ui, "Close second surface", enabled=has_second):
        close = partial(context.session.set_surfaces, context.session.surface("source"))
        context.files.when_free("closing the second surface", close)
    ui.tip("" if has_second else "No second surface is open.")
    if menu_item(ui, "Open landmarks..."):
        landmarks.open_file(context)


def _recent_label(paths: tuple[Path, ...]) -> str:
    """Return ``A to B`` for two surfaces, ``frames on mesh`` for a sequence, or a short path."""
    if len(paths) == 1:
        return _short(paths[0])
    first, second = (path.name for path in paths)
    return f"{second} on {first}" if is_named_as_frames(paths[1]) else f"{first} to {second}"


def _short(path: Path) -> str:
    home = Path.home()
    text = str(Path("~", path.relative_to(home)) if path.is_relative_to(home) else path)
    if len(text) <= _PATH_LENGTH_MAX:
        return text
    return f"{text[:15]}...{text[-_PATH_LENGTH_MAX + 18 :]}"


def _edit(ui: Ui, actions: Actions) -> None:
    editor = actions.context.session.editor
    undo = "Undo", actions.undo, editor.undo_label
    redo = "Redo", actions.redo, editor.redo_label
    for label, action, what in (undo, redo):
        hint = f"{what}   {action.hint}" if what else action.hint
        if menu_item(ui, label, hint, enabled=bool(what)):
            action.do()
        ui.tip("" if what else f"There is nothing to {label.lower()}.")
    imgui.Separator()
    places = actions.context.session.view.tool == "landmark"
    if menu_item(ui, "Place landmarks", actions.place_landmarks.hint, places):
        actions.place_landmarks.do()
    imgui.Separator()
    session = actions.context.session
    if menu_item(ui, session.match_label, actions.match.hint, enabled=session.can_match):
        actions.match.do()
    other, enabled = session.other_match_label, session.can_match_otherwise
    if menu_item(ui, other, actions.match_otherwise.hint, enabled=enabled):
        actions.match_otherwise.do()
    imgui.Separator()
    is_changed = editor.document.parameters != Parameters()
    if menu_item(ui, "Reset to defaults", enabled=is_changed):
        editor.reset_parameters()
    ui.tip("" if is_changed else "All parameters have their defaults.")


def _view(ui: Ui, actions: Actions) -> None:
    session = actions.context.session
    view, set_view = session.view, session.editor.set_view
    for theme in THEMES:
        keys = actions.switch_theme.hint if theme != view.theme else ""
        if menu_item(ui, f"{theme.capitalize()} theme", keys, checked=view.theme == theme):
            session.set_appearance(theme=theme)
    _choices(ui, session, "UI scale", "ui_scale", {f"{scale:g}": scale for scale in UI_SCALES})
    imgui.Separator()
    _choices(ui, session, "Layout", "layout", {name: name for name in LAYOUTS})
    maps = ("automatic", *colormaps.NAMES)
    _choices(ui, session, "Colour map", "colormap", {name: name for name in maps})
    for label, name in (("Isolines", "isolines"), ("Colour bar", "color_bar")):
        shown = getattr(view, name)
        if menu_item(ui, label, checked=shown):
            what = f"{'hide' if shown else 'show'} the {label.lower()}"
            set_view(what, "", **{name: not shown})
    flat = ("Flat shading", actions.flat, view.flat)
    for label, action, shown in (("Wireframe", actions.wireframe, view.wireframe), flat):
        if menu_item(ui, label, action.hint, shown):
            action.do()
    is_finer = session.result is not None and session.result.refined > 0
    can_switch = is_finer or view.finer
    if menu_item(ui, "Finer mesh", checked=view.finer, enabled=can_switch):
        session.editor.set_view("toggle the finer mesh", finer=not view.finer)
    ui.tip(_FINER_TIP if can_switch else f"No match was found on a finer mesh.\n\n{_FINER_TIP}")
    if menu_item(ui, "Flow after a match", checked=view.flow_after_match):
        session.switch_flow_after_match()
    ui.tip("After a match, show its flow by streaks or arrows, and play it once.")
    imgui.Separator()
    with menu(ui, "Surfaces") as is_open:
        if is_open:
            _surfaces(ui, actions)
    with menu(ui, "Look from") as is_open:
        _items(ui, {"Best view": actions.best_view, **actions.sides()} if is_open else {})
    _items(ui, {"Reset camera": actions.reset})


def _samples(ui: Ui, actions: Actions) -> None:
    samples.draw(ui, actions.context.files, actions.context.textures)


def _surfaces(ui: Ui, actions: Actions) -> None:
    view = actions.context.session.view
    for name in view.surfaces:
        if menu_item(ui, name, checked=name in view.shown_surfaces):
            actions.hide_or_show(name)
    imgui.Separator()
    _items(ui, {"Show all": actions.show_all})


def _choices(ui: Ui, session: Session, label: str, name: str, choices: dict[str, Any]) -> None:
    what = f"change the {label.lower()}"
    with menu(ui, label) as is_open:
        for choice, value in choices.items() if is_open else ():
            if menu_item(ui, choice, checked=getattr(session.view, name) == value):
                if name in APPEARANCE:
                    session.set_appearance(**{name: value})
                else:
                    session.editor.set_view(what, **{name: value})


def _help(ui: Ui, actions: Actions) -> None:
    if menu_item(ui, "Tour"):
        actions.tour.start()
    _items(ui, {"Search actions...": actions.search, "Shortcuts": actions.show_shortcuts})
    if menu_item(ui, "Messages"):
        actions.show_messages()
    if menu_item(ui, "About"):
        actions.show_about()
