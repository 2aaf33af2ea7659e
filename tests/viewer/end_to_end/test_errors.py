"""Exceptions do not end the app: each part shows its error, and the others work."""

from abfm_viewer.panels import right_panel, solver, status_line, time_bar
from abfm_viewer.widgets.containers import child, section
from abfm_viewer.window import menus, window
from tests.messages import check_message
from tests.viewer.sessions import QUICK, match

PARTS = {"menu": menus, "time bar": time_bar, "status line": status_line, "Solver": solver}
PANELS = [(tab, part) for tab, parts in right_panel.TABS.items() for part in parts]


def fail(*_arguments, **_options):
    raise RuntimeError("the roof leaks")


def works(gui):
    """Return whether the window still draws frames and responds."""
    before = gui.window.frames
    gui.frames(3)
    gui.key("l")
    gui.key("l")
    return gui.window.frames > before + 3


def test_tour_of_errors(gui, monkeypatch, capsys):
    fail_in_every_part(gui, monkeypatch, capsys)
    fail_in_every_panel(gui, monkeypatch)


def fail_in_every_part(gui, monkeypatch, capsys):
    """Check that parts, a solver, a scene, a session and a dialog recover."""
    places = {part: (module, "draw") for part, module in PARTS.items()}
    for part, place in (places | {"labels": (window, "draw_annotations")}).items():
        with monkeypatch.context() as patch:
            patch.setattr(*place, fail)
            gui.frames(3)
            assert gui.errors == {part: "RuntimeError: the roof leaks"}
            assert gui.session.notices.latest.is_error
            check_message(gui.session.notices.latest.text, part, "RuntimeError: the roof leaks")
            assert works(gui)
        gui.frames(2)
        assert gui.errors == {}
        assert capsys.readouterr().err.count("Traceback") == 1
    with monkeypatch.context() as patch:
        patch.setattr("abfm_viewer.computing.run.Process.solve", fail)
        match(gui)
    assert gui.session.solver.failed
    check_message(gui.session.notices.latest.text, "RuntimeError: the roof leaks")
    gui.session.editor.amend(parameters=QUICK)
    match(gui)
    assert not gui.session.solver.failed
    for method in ("update", "pick"):
        with monkeypatch.context() as patch:
            patch.setattr(gui.window.scene, method, fail)
            gui.input.move(100, 200)
            gui.input.set_modifier("shift", True)
            gui.input.click()
            gui.input.set_modifier("shift", False)
            assert set(gui.errors) <= {"scene", "mouse", "labels"}
            assert works(gui)
        gui.frames(2)
    with monkeypatch.context() as patch:
        patch.setattr(gui.session, "update", fail)
        gui.frames(2)
        assert gui.errors == {"session": "RuntimeError: the roof leaks"}
    gui.frames(2)
    assert works(gui)
    with monkeypatch.context() as patch:
        patch.setattr("abfm_viewer.dialogs.dialogs.Message.draw", fail)
        gui.menu("Help", "About")
        gui.frames(2)
        assert not gui.window.dialogs.is_open
    assert works(gui)


def fail_in_every_panel(gui, monkeypatch):
    """Check that other panels and ImGui stay complete, also after half a panel."""
    for tab, panel in PANELS:
        gui.click(tab, within=right_panel.STEPS)
        with monkeypatch.context() as patch:
            patch.setitem(right_panel.TABS[tab], panel, fail)
            gui.frames(3)
            assert gui.errors == {panel: "RuntimeError: the roof leaks"}
            assert set(right_panel.TABS) <= set(gui.labels())
            assert works(gui)
            gui.drag("time", 0.5)
        gui.frames(2)
        assert gui.errors == {}

    def draw(context):
        ui = context.ui
        inner, more = child(ui, "inner", 40), section(ui, "more")
        with ui.group("deep"), ui.disabled(), inner, more as is_open:
            assert is_open
            fail()

    with monkeypatch.context() as patch:
        for tab, panel in PANELS:
            patch.setitem(right_panel.TABS[tab], panel, draw)
        for tab, panels in right_panel.TABS.items():
            gui.click(tab, within=right_panel.STEPS)
            assert works(gui)
            assert set(gui.errors) == set(panels)
    gui.frames(2)
    assert gui.errors == {}
    gui.type("alpha", "3")
    assert gui.session.parameters.alpha == 3
