"""The time bar."""

from __future__ import annotations

import polyscope.imgui as imgui

from abfm_viewer.session import Session
from abfm_viewer.ui import Rect, Ui


def draw(ui: Ui, session: Session, rect: Rect) -> None:
    """Draw play, and the slider over 0 to 2 tau."""
    with ui.window("time bar", rect):
        if ui.button("Pause" if session.player.playing else "Play"):
            session.player.toggle()
        ui.beside()
        imgui.SetNextItemWidth(-ui.px(70))
        changed, value = imgui.SliderFloat("time", session.time, 0, session.end)
        ui.record("time", "slider", (*imgui.GetItemRectMin(), *imgui.GetItemRectMax()), 0, session.end)
        if changed:
            session.set_time(value)
