"""The time bar: playing the flow, and the slider over 0 to 2 tau."""

from __future__ import annotations

import math

import polyscope.imgui as imgui

from abfm_viewer.session.player import REPEATS
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.slider_scale import share_of, value_at
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.widgets.widget_record import Rect

STEP = 1 / 20
"""Of tau: how far a step moves in time."""
_SLOWEST, _FASTEST = 0.1, 4.0
_PLAIN = imgui.ImGuiSliderFlags_NoInput | imgui.ImGuiSliderFlags_NoRoundToFormat
_NARROW = 600  # at a scale of 1: below, the bar needs a row more
_HEIGHT, _ROW = 82, 30


def height(width: float, scale: float) -> float:
    """How high a bar of a certain width must be, in pixels."""
    return (_HEIGHT + (_ROW if width < _NARROW * scale else 0)) * scale


def draw(ui: Ui, session: Session, rect: Rect) -> None:
    """Draw buttons, ways to play, and the slider."""
    with ui.window("time bar", rect), ui.group("time bar"):
        _buttons(ui, session)
        if rect[2] - rect[0] >= ui.px(_NARROW):
            ui.beside(ui.px(16))
        _ways(ui, session)
        _slider(ui, session)


def _buttons(ui: Ui, session: Session) -> None:
    player = session.player
    step = STEP * session.parameters.tau
    tip = "Hold (Space)." if player.playing else "Show the function on its way (Space)."
    if ui.button("Pause" if player.playing else "Play", tip, width=ui.px(52)):
        player.toggle()
    for label, seconds, tip in (("<", -step, "A twentieth of tau back."), (">", step, "A twentieth of tau on.")):
        ui.beside(ui.px(4))
        if ui.button(label, tip, width=ui.px(24)):
            _show(session, session.time + seconds)
    ui.beside(ui.px(4))
    if ui.button("to start", "Show the source, time 0."):
        _show(session, 0.0)
    ui.beside()
    player.beyond = ui.checkbox("beyond tau", player.beyond, "Play on to 2 tau, where the flow extrapolates.")


def _ways(ui: Ui, session: Session) -> None:
    player = session.player
    player.repeat = ui.combo("repeat", player.repeat, REPEATS, "What happens at the end.", width=ui.px(104))
    ui.beside(ui.px(12))
    imgui.SetNextItemWidth(ui.px(64))
    shown = share_of(player.speed, _SLOWEST, _FASTEST, True)
    changed, share = imgui.SliderFloat("##speed", shown, 0.0, 1.0, "", _PLAIN)
    ui.record("speed", "slider", low=_SLOWEST, high=_FASTEST, text=f"{player.speed:.2g}", log=True)
    ui.tip("1 goes from 0 to tau in four seconds.")
    if changed:
        player.speed = float(f"{value_at(share, _SLOWEST, _FASTEST, True):.2g}")
    ui.beside(ui.px(6))
    imgui.AlignTextToFramePadding()
    ui.note(f"speed {player.speed:g}", "ink")


def _slider(ui: Ui, session: Session) -> None:
    """The slider over 0 to 2 tau; right of its tick at tau is what no target was given for."""
    box, spacing = ui.px(64), imgui.GetStyle().ItemInnerSpacing[0]
    width = imgui.GetContentRegionAvail()[0] - box - 2 * spacing - imgui.CalcTextSize("time")[0]
    left, top = imgui.GetCursorScreenPos()
    _track(ui, session, (left, top, left + width, top + imgui.GetFrameHeight()))
    imgui.SetNextItemWidth(width)
    imgui.PushStyleColor(imgui.ImGuiCol_FrameBg, (0, 0, 0, 0))
    changed, time = imgui.SliderFloat("##time slider", session.time, 0.0, session.end, "", _PLAIN)
    imgui.PopStyleColor()
    ui.record("time", "slider", high=session.end, text=f"{session.time:.6g}")
    ui.tip(session.shown.note or "0 is the source, tau the match; beyond, the flow goes on by itself.")
    if changed:
        _show(session, time)
    ui.beside(spacing)
    typed = ui.text("time", f"{session.time:.4g}", "The time that is shown, 0 to 2 tau.", width=box)
    if typed is not None:
        try:
            time = float(typed)
        except ValueError:
            time = math.nan
        if math.isfinite(time):
            _show(session, time)
        else:
            session.say(f"time: {typed!r} is no number", is_error=True)


def _track(ui: Ui, session: Session, rect: Rect) -> None:
    """Draw what lies under the slider's grab."""
    left, top, right, bottom = rect
    colors, canvas = ui.colors, imgui.GetWindowDrawList()
    rounding = imgui.GetStyle().FrameRounding
    middle = (left + right) / 2
    canvas.AddRectFilled((left, top), (right, bottom), _packed(colors.field), rounding)
    tint, corners = _packed((*colors.marker[:3], 0.16)), imgui.ImDrawFlags_RoundCornersRight
    canvas.AddRectFilled((middle, top), (right, bottom), tint, rounding, corners)
    canvas.AddLine((middle, top), (middle, bottom), _packed(colors.ink), ui.px(1.5))
    note = session.shown.note
    text, color = ("cannot be followed", colors.error) if note else ("extrapolation", colors.muted)
    size = imgui.CalcTextSize(text)
    place = (right - size[0] - ui.px(6), (top + bottom - size[1]) / 2)
    if place[0] > middle + ui.px(12):
        canvas.AddText(place, _packed(color), text)
    canvas.AddText((middle - ui.px(12) - imgui.CalcTextSize("tau")[0], place[1]), _packed(colors.ink), "tau")


def _show(session: Session, time: float) -> None:
    """Show a time that the user chose."""
    session.player.playing = False
    session.set_time(time)


def _packed(color: tuple[float, float, float, float]) -> int:
    return int(imgui.GetColorU32(color))
